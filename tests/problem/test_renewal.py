"""When M no longer fits the pixels that a frame shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.functionals.correlation import read_correlation
from ddic.functionals.view import View
from ddic.images.sub_image import DeformedSubImage
from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.parallel.distribution import split_evenly
from ddic.parallel.field import ByView, Field
from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.partition.split import split_by_blocks
from ddic.problem.assembly import CHANGED_SHARE, CHANGED_SIDE, HELD_SHARE, AssembledFrom, Assembly, find_renewal
from ddic.problem.residual_model import ResidualModel
from ddic.solvers.local_system import LocalSystem
from ddic.synth.fields import Translation
from support.pictures import pair_of, source, square_mesh

RANKS = [1, 3]
SIDE = 192
MESH = square_mesh(24.0, 168.0)
IMAGE = pair_of(Translation((0.0, 0.0)), SIDE, 8).reference
LONG, NONE = 1000.0, 0.0
"""Cut-off wavelengths."""

Rectangle = tuple[int, int, int, int]
"""Columns and rows from and to, pixels of the image; displacements are zero."""


class Region:
    """2 x 2 subdomains of 72 x 72 px, those of this rank; frames show the reference image, a part of it hidden."""

    def __init__(self, mesh: Mesh = MESH, blocks: tuple[int, int] = (2, 2)) -> None:
        self.team = Team.world()
        controlled = np.ones(mesh.n_dofs, dtype=bool)
        everything = build_subdomains(NodalRegion(mesh), split_by_blocks(mesh, blocks), controlled)
        self.own = [everything[k] for k in split_evenly(np.ones(len(everything)), self.team.size)[self.team.rank]]
        self.views = ByView([View(read_correlation(s.mesh, source(IMAGE), 3), s.kinematics)] for s in self.own)
        self.hessians = self.views.map(View.assemble_hessian)
        self.whole = AssembledFrom.all_of(self.own, self.views)
        systems = [LocalSystem(s, m, None, np.zeros(0), 0.0) for s, (m,) in zip(self.own, self.hessians, strict=True)]
        self.assembly = Assembly(systems, 0.0, 1.0)

    def frame(self, *hidden: Rectangle) -> ResidualModel:
        mask = np.ones(IMAGE.shape, dtype=bool)
        for x0, x1, y0, y1 in hidden:
            mask[y0:y1, x0:x1] = False
        views = self.views.map(lambda view: view.open_frame(DeformedSubImage(source(IMAGE, mask), 3)))
        return ResidualModel(self.team, self.own, views, "none")

    @property
    def q(self) -> Field:
        return Field.zero(self.team, self.own)

    def renew(self, counted: AssembledFrom, wavelength: float, *hidden: Rectangle,
              ) -> tuple[list[int], AssembledFrom, list[NDArray[np.float64] | None], str]:
        """Subdomains renewed on all ranks, what M counts then, this rank's new M, and what the log says."""
        renewal = find_renewal(self.frame(*hidden), self.q, (counted, self.hessians), wavelength, self.assembly)
        renewed = [s.index for s, system in zip(self.own, renewal.systems, strict=True) if system is not None]
        dense = [None if system is None else system.hessian.toarray() for system in renewal.systems]
        return self.team.gather_lists(renewed), renewal.assembled_from, dense, "".join(renewal.notes)


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("wavelength", [LONG, NONE], ids=["regularized", "plain"])
def test_nothing_changes_where_nothing_is_hidden(wavelength: float) -> None:
    region = Region()
    assert region.renew(region.whole, wavelength)[0] == []
    # Somewhere else than on the mesh.
    renewed, _, _, note = region.renew(region.whole, wavelength, (0, 20, 0, SIDE))
    assert (renewed, note) == ([], "")


@pytest.mark.parallel(RANKS)
def test_a_few_hidden_pixels_change_nothing_and_a_share_renews_one() -> None:
    region = Region()
    # 72 x 72 px, of which a mask of n x n hides (n + 3)^2 through the taps of the spline.
    assert 8**2 < CHANGED_SHARE * 72**2 < 14**2
    assert region.renew(region.whole, LONG, (40, 44, 40, 44))[0] == []
    renewed, _, _, note = region.renew(region.whole, LONG, (40, 54, 40, 54))
    assert renewed == [0]
    assert note.startswith("1 subdomains (0) lost or gained")


@pytest.mark.parallel(RANKS)
def test_less_may_be_hidden_where_shorter_waves_pass() -> None:
    region = Region()
    # A mask of 4 x 4 px is below the share, but above the square of half a wavelength of 6 px.
    assert (CHANGED_SIDE * 6.0) ** 2 < 4**2
    assert region.renew(region.whole, 6.0, (40, 44, 40, 44))[0] == [0]


@pytest.mark.parallel(RANKS)
def test_new_m_is_that_of_the_pixels_shown_and_a_share_of_the_others() -> None:
    region = Region()
    hidden = (30, 70, 30, 70)
    for wavelength, share in ((LONG, HELD_SHARE), (NONE, 0.0)):
        _, visible, found, _ = region.renew(region.whole, wavelength, hidden)
        for s, (view,), m, (whole,) in zip(region.own, region.frame(hidden).views, found, region.hessians, strict=True):
            if s.index != 0:
                assert m is None
                continue
            shown = view.without_hidden(np.zeros(s.n_unknowns))
            assert m is not None
            expected = (1 - share) * shown.assemble_hessian().toarray() + share * whole.toarray()
            if wavelength == NONE:
                # Interfaces stay held: the pixels of a neighbour alone may see their nodes.
                expected += np.diag(HELD_SHARE * whole.diagonal() * (s.multiplicity > 1))
            # The same sums once more.
            np.testing.assert_allclose(m, expected, rtol=1e-14, atol=0)
        # What M counts now asks for no other.
        assert region.renew(visible, wavelength, hidden)[0] == []


@pytest.mark.parallel([1, 3])
def test_a_subdomain_is_regular_where_neighbours_alone_see_its_interface() -> None:
    # The cell at the inner corner of the first block: nothing in it shows the corner, which the other blocks see.
    region = Region()
    inner = (24 + 64 - 20, 24 + 72 + 1, 24 + 64 - 20, 24 + 72 + 1)
    _, _, found, note = region.renew(region.whole, NONE, inner)
    assert "follow their neighbours" not in note
    for s, m, (whole,) in zip(region.own, found, region.hessians, strict=True):
        if s.index == 0:
            assert m is not None
            unseen = np.diag(m) < 1e-5 * whole.diagonal()
            assert (s.multiplicity[unseen] > 1).all()
            assert unseen.sum() == 2
            # The factor asks for 1e-9 of the mean diagonal.
            assert np.linalg.eigvalsh(m)[0] > 1e-8 * whole.diagonal().mean()


@pytest.mark.parallel(RANKS)
def test_pixels_that_come_back_renew_as_well() -> None:
    region = Region()
    hidden = (30, 70, 30, 70)
    _, visible, _, _ = region.renew(region.whole, LONG, hidden)
    renewed, visible, found, _ = region.renew(visible, LONG)
    assert renewed == [0]
    for s, m, (whole,) in zip(region.own, found, region.hessians, strict=True):
        if s.index == 0:
            assert m is not None
            # 0.99 M + 0.01 M.
            np.testing.assert_allclose(m, whole.toarray(), rtol=1e-14, atol=0)
    assert region.renew(visible, LONG)[0] == []


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("wavelength", [LONG, NONE], ids=["regularized", "plain"])
def test_as_many_other_pixels_renew_as_well(wavelength: float) -> None:
    # M that lacks the pixels that are shown would be too small there, and overshoot.
    region = Region()
    left, right = (30, 44, 34, 62), (66, 80, 34, 62)
    renewed, visible, _, _ = region.renew(region.whole, wavelength, left)
    assert renewed == [0]
    _, others, _, _ = region.renew(region.whole, wavelength, right)
    # Guards the test: the numbers are the same within what M bears.
    totals = [sum(int(np.sum(of_view)) for of_views in v.n_pixels for of_view in of_views) for v in (visible, others)]
    assert abs(totals[0] - totals[1]) <= 0.2 * CHANGED_SHARE * 72**2
    assert region.renew(visible, wavelength, right)[0] == [0]


@pytest.mark.parallel([1, 2])
def test_a_node_without_a_row_that_loses_its_pixels_renews() -> None:
    # A cell of 8 px is less of its 72 x 144 px than the share, but M would hold the node at the corner.
    mesh = build_structured_mesh((24, 24, 168, 168), 8)
    cell = (24, 32, 24, 32)
    assert CHANGED_SHARE * 72 * 144 > (32 + 2 - 24)**2
    region = Region(mesh, (2, 1))
    assert region.renew(region.whole, LONG, cell)[0] == []
    # A subdomain of another thinks that it sees the corner: else nothing would hold it here, where there is no K.
    region.own = [replace(s, controlled=np.arange(s.n_field) >= 2, multiplicity=s.multiplicity + 1) for s in region.own]
    region.assembly = replace(region.assembly, systems=[replace(system, subdomain=s) for system, s in zip(
        region.assembly.systems, region.own, strict=True)])
    renewed, visible, _, _ = region.renew(region.whole, LONG, cell)
    assert renewed == [0]
    # They are lost once.
    assert region.renew(visible, LONG, cell)[0] == []


@pytest.mark.parallel([1, 2])
def test_a_node_that_is_held_by_pixels_alone_renews_where_it_loses_most() -> None:
    # Of 72 x 144 px the share bears 207. A mask of n x n hides (n + 3)^2 of the 16 x 16 about the node at (48, 48).
    mesh = build_structured_mesh((24, 24, 168, 168), 8)
    most, few = (43, 52, 43, 52), (46, 50, 46, 50)
    assert 7**2 < 0.5 * 16**2 < 12**2 < CHANGED_SHARE * 72 * 144
    for controlled, expected in ((True, []), (False, [0])):
        region = Region(mesh, (2, 1))
        region.own = [replace(s, controlled=np.full(s.n_field, controlled)) for s in region.own]
        assert region.renew(region.whole, LONG, few)[0] == []
        assert region.renew(region.whole, LONG, most)[0] == expected


@pytest.mark.parallel([1, 2])
def test_unknowns_without_pixels_and_rows_are_in_equilibrium() -> None:
    region = Region(build_structured_mesh((24, 24, 168, 168), 8), (2, 1))
    region.own = [replace(s, controlled=s.mesh.nodes.repeat(2, axis=0)[:, 0] > 25.0) for s in region.own]
    systems = [replace(system, subdomain=s) for system, s in zip(region.assembly.systems, region.own, strict=True)]
    region.assembly = replace(region.assembly, systems=systems, edge_weight=0.25)
    # Of the left edge, in the first subdomain, the four nodes from 48 to 72 px lose all pixels.
    hidden = (0, 40, 40, 82)
    renewal = find_renewal(region.frame(hidden), region.q, (region.whole, region.hessians), LONG, region.assembly)
    for s, system in zip(region.own, renewal.systems, strict=True):
        if s.index == 0:
            assert system is not None
            assert system.projection is not None
            x, y = s.mesh.nodes.repeat(2, axis=0).T
            expected = np.where((x > 25.0) | ((y >= 48.0) & (y <= 72.0)), 1.0, 0.25)
            np.testing.assert_array_equal(system.projection, expected)
        else:
            assert system is None
    assert any("follow their neighbours" in note for note in renewal.notes)

"""Kinematics of one's own, from images to a field: integrated DIC, and nodes that are fixed in part."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import InputError, SingularSubdomainError, is_collective
from ddic.kinematics.linear import LinearRegion
from ddic.mesh.mesh import Mesh
from ddic.parallel.team import Team
from ddic.results.publishing import gather
from ddic.synth.fields import Affine, DisplacementField
from support.cases import Ears, write_case, write_images
from support.measuring import field_on_one_rank, measure, whole_field

RANKS = [1, 3]
TIGHT = "[gauss_newton]\ntolerance = 1e-12\nrms_tolerance = 1e-11\nmax_iterations = 100\n"
REGULARIZED = "[regularization]\ncut_off_wavelength = 64.0\n"
AGREE_PX = 1e-9
"""Gauss-Newton to 1e-11 px and Krylov to 1e-13: what the ways to solve leave differs by less."""


def solver(method: str) -> str:
    number = "" if method == "monolithic" else "subdomains = 4\n"
    return f'[solver]\nmethod = "{method}"\n{number}tolerance = 1e-13\nmax_iterations = 2000\ninexact = false\n'


def evaluate_modes(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rigid motion, uniform strain, and six bending modes at points (..., 2) of -1..1: (12, ..., 2)."""
    x, y = np.moveaxis(points, -1, 0)
    one, nothing = np.ones_like(x), np.zeros_like(x)
    rigid = [(one, nothing), (nothing, one), (-y, x)]
    strain = [(x, nothing), (nothing, y), (y, x)]
    # Pure bending along both axes, and deflections that shear forces add.
    bending = [(x * y, -x**2 / 2), (-y**2 / 2, x * y), (nothing, x**2), (y**2, nothing), (nothing, x**3),
               (y**3, nothing)]
    return np.stack([np.stack(mode, axis=-1) for mode in (*rigid, *strain, *bending)])


def bend(mesh: Mesh) -> LinearRegion:
    """Twelve unknowns, all of them everywhere."""
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    modes = evaluate_modes(2 * (mesh.nodes - low) / (high - low) - 1)
    return LinearRegion(mesh, sparse.csr_matrix(modes.reshape(len(modes), -1).T))


def fix_every_third_along_y(mesh: Mesh) -> LinearRegion:
    """Two unknowns at most nodes, one at every third, which is fixed along y."""
    moves = np.ones(mesh.nodes.shape, dtype=bool)
    moves[::3, 1] = False
    return LinearRegion(mesh, sparse.identity(mesh.n_dofs, format="csr")[:, np.flatnonzero(moves)])


class Bent:
    """A displacement that the modes hold on the region of columns and rows 24 to 168."""

    amplitudes = np.array([0.4, -0.3, 0.2, 0.3, -0.2, 0.1, 0.5, -0.4, 0.2, 0.3, -0.2, 0.1])

    def displacement(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """At points (..., 2), pixels."""
        return np.asarray(np.tensordot(self.amplitudes, evaluate_modes((points - 96.0) / 72.0), axes=1))

    def gradient(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """du_i/dx_j, (..., 2, 2), by differences: good enough for Newton's method, which inverts the field."""
        step = 1e-3
        columns = [(self.displacement(points + step * e) - self.displacement(points - step * e)) / (2 * step)
                   for e in np.eye(2)]
        return np.stack(columns, axis=-1)


ALONG_X = Affine(((0.006, 0.004), (0.0, 0.0)), (0.3, 0.0), (96.0, 96.0))


def write(team: Team, folder: Path, field: DisplacementField, more: str) -> Path:
    if team.is_root:
        if not (folder / "f.tif").exists():
            write_images(folder, field)
        write_case(folder, more)
    team.wait_for_all()
    return folder / "case.toml"


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("regularization", ["", REGULARIZED], ids=["plain", "regularized"])
@pytest.mark.parametrize(("choose", "field"), [(bend, Bent()), (fix_every_third_along_y, ALONG_X)],
                         ids=["integrated", "fixed components"])
def test_all_ways_to_solve_agree(shared_path: Path, choose: Callable[[Mesh], LinearRegion], field: DisplacementField,
                                 regularization: str) -> None:
    team = Team.world()
    path = write(team, shared_path, field, solver("monolithic") + TIGHT + regularization)
    expected = field_on_one_rank(path, choose)
    team.wait_for_all()
    for method in ("dual", "assembled", "conjugate_gradient"):
        path = write(team, shared_path, field, solver(method) + TIGHT + regularization)
        measured = measure(team, path, choose_kinematics=choose)
        found = whole_field(measured)
        assert np.abs(found - expected).max() <= AGREE_PX, method
        assert measured.largest_jump <= AGREE_PX, method
        assert measured.size.n_subdomains == 4
        assert (measured.size.n_interface > 0) == (method == "dual")


@pytest.mark.parallel([1, 3])
def test_integrated_dic_finds_the_modes(shared_path: Path) -> None:
    team = Team.world()
    path = write(team, shared_path, Bent(), solver("dual"))
    ears = Ears()
    measured = measure(team, path, ears, bend)
    nodes = np.concatenate(team.gather_lists([s.mesh.nodes for s in measured.subdomains]))
    u = np.concatenate(team.gather_lists([u.reshape(-1, 2) for u in measured.displacements]))
    error = u - Bent().displacement(nodes)
    # Twelve unknowns of 20 000 pixels: the scatter of what the spline and rounding leave is far below its bias of
    # 1.4e-3 px; bilinear cells of 16 px leave the modes' curvature, (16/72)^2 / 8 = 6e-3 of an amplitude.
    assert np.sqrt((error**2).mean()) <= 5e-3
    for s, q in zip(measured.subdomains, measured.q, strict=True):
        assert s.numbers.tolist() == list(range(12))
        # The last modes' amplitudes are their value at the region's edge.
        np.testing.assert_allclose(q, Bent.amplitudes, atol=2e-2)
    assert measured.size.n_unknowns == 12
    # Three rows for each unknown of four subdomains.
    assert measured.size.n_interface == 36


@pytest.mark.parallel([1, 3])
def test_fixed_components_stay(shared_path: Path) -> None:
    team = Team.world()
    measured = measure(team, write(team, shared_path, ALONG_X, solver("dual")), None, fix_every_third_along_y)
    field = whole_field(measured)
    assert measured.size.n_unknowns == 200 - 34
    assert (field[::3, 1] == 0).all()
    assert np.abs(field[:, 0]).max() > 0.5
    points = np.random.default_rng(0).uniform(30, 160, (100, 2))
    # As on cells of 16 px without anything fixed, see test_dd_dic.
    assert np.sqrt(((gather(measured).at(points) - ALONG_X.displacement(points))**2).mean()) <= 1e-2


@pytest.mark.parallel([1, 3])
def test_a_kinematics_of_another_mesh_is_refused(shared_path: Path) -> None:
    team = Team.world()
    path = write(team, shared_path, ALONG_X, solver("dual"))

    def choose(mesh: Mesh) -> LinearRegion:
        return LinearRegion(mesh, sparse.identity(mesh.n_dofs + 1, format="csr"))

    with pytest.raises(InputError, match="has 201 rows, the mesh 200 displacements") as caught:
        measure(team, path, choose_kinematics=choose)
    assert is_collective(caught.value)


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("method", ["assembled", "conjugate_gradient"])
def test_subdomains_may_be_too_small_to_tell_modes_apart(shared_path: Path, method: str) -> None:
    # Every subdomain is a cell, which has eight displacements for twelve modes.
    team = Team.world()
    expected = field_on_one_rank(write(team, shared_path, Bent(), solver("monolithic") + TIGHT), bend)
    team.wait_for_all()
    path = write(team, shared_path, Bent(), solver(method).replace("subdomains = 4", "subdomains = 81") + TIGHT)
    measured = measure(team, path, choose_kinematics=bend)
    assert measured.size.n_subdomains == 81
    assert np.abs(whole_field(measured) - expected).max() <= AGREE_PX


@pytest.mark.parallel([1, 3])
def test_the_dual_method_refuses_such_subdomains(shared_path: Path) -> None:
    team = Team.world()
    path = write(team, shared_path, Bent(), solver("dual").replace("subdomains = 4", "subdomains = 81") + TIGHT)
    with pytest.raises(SingularSubdomainError, match=r"^subdomain \d+ \(columns") as caught:
        measure(team, path, choose_kinematics=bend)
    assert is_collective(caught.value)

"""A plate with a blank quarter: subdomains without texture join a neighbour."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import tifffile
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.case.loader import load_case
from ddic.errors import InputError, SingularSubdomainError, is_on_all_ranks
from ddic.io.result_reader import read_result
from ddic.methods.dd_dic import Measurement, dd_dic
from ddic.methods.run import run_case
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.problem.assembly import correlate, own_parts, seen_parts
from ddic.problem.blank_subdomains import Correlated, with_texture
from ddic.problem.inputs import open_pair, share_out
from ddic.problem.mesh_source import build_mesh
from ddic.results.listener import Silence
from ddic.start.coarse_field import coarse_field, coarse_task
from ddic.synth.fields import Affine
from support.cases import Ears, write_case, write_images

RANKS = [1, 2, 4]
SIDE = 256
REGION = "region = [32, 32, 224, 224]"
"""12 x 12 cells of 16 px, 4 x 4 blocks of 48 px; l_c is half of it."""

FADE = 16.0
"""Width over which the texture fades out, so that the deformed image knows where at any fraction of a pixel."""

TIGHT = "[gauss_newton]\ntolerance = 1e-10\nrms_tolerance = 0.0\n"
BLOCKS = '[solver]\npartition = "blocks"\nblocks = [4, 4]\ntolerance = 1e-12\n'
METIS = "[solver]\nsubdomains = 13\ntolerance = 1e-12\n"
SAME_PX = 1e-8
"""Gauss-Newton to 1e-10 of |q| and Krylov to 1e-12 leave 1e-10 px; A_s of a subdomain that texture holds at one end
only may lose two digits of that, for l_c is but two such subdomains long. Measured: 6e-13 px."""

MONOLITHIC = '[solver]\nmethod = "monolithic"\n'


@dataclass(frozen=True)
class Plate:
    """A plate with a blank rectangle.

    blank: (x0, y0, x1, y1), pixels; field: a displacement in equilibrium with the edges;
    not_controlled: loaded edges; blocks: those of 4 x 4 without texture.
    """

    blank: tuple[float, float, float, float]
    field: Affine
    not_controlled: str
    blocks: tuple[int, ...]

    @property
    def regularization(self) -> str:
        return f"[regularization]\ncut_off_wavelength = 96.0\nnot_controlled = {self.not_controlled}\n"


# Free edges bear no traction, hence a rigid motion (its rotation infinitesimal, as the strain of the gap is).
CORNER = Plate((120.0, 120.0, 400.0, 400.0), Affine(((0.0, -3e-3), (3e-3, 0.0)), (0.3, -0.2), (128.0, 128.0)), "[]",
               (10, 11, 14, 15))
# All edges are loaded, hence any uniform strain.
MIDDLE = Plate((72.0, 72.0, 184.0, 184.0), Affine(((3e-3, 1e-3), (0.0, -2e-3)), (0.3, -0.2), (128.0, 128.0)),
               '["boundary"]', (5, 6, 9, 10))


def _contrast(x: NDArray[np.float64], blank: tuple[float, float, float, float]) -> NDArray[np.float64]:
    """1 on the texture, 0 on the blank rectangle's points, (...); x: (..., 2), pixels."""
    depth = np.minimum(x - np.array(blank[:2]), np.array(blank[2:]) - x).min(axis=-1)
    t = np.clip(-depth / FADE, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _write(folder: Path, plate: Plate, more: str, noise: float = 0.0, images: str = "") -> Path:
    if MPI.COMM_WORLD.rank == 0:
        write_images(folder, plate.field, SIDE)
        rng = np.random.default_rng(0)
        pixels = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), axis=-1).astype(float)
        gradient, centre = np.array(plate.field.matrix), np.array(plate.field.center)
        material = (pixels - centre - np.array(plate.field.vector)) @ np.linalg.inv(np.eye(2) + gradient).T + centre
        for name, points in (("f.tif", pixels), ("g.tif", material)):
            image = 128.0 + (tifffile.imread(folder / name) - 128.0) * _contrast(points, plate.blank)
            image += noise * rng.standard_normal(image.shape)
            tifffile.imwrite(folder / name, np.clip(np.round(image), 0, 255).astype(np.uint8))
        write_case(folder, more, region=REGION, images=images)
    MPI.COMM_WORLD.barrier()
    return folder / "case.toml"


def _measure(team: Team, path: Path, ears: Ears | None = None) -> Measurement:
    return dd_dic(team, load_case(path).case, ears or Silence(), PhaseClock())


def _field(team: Team, measurement: Measurement) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Nodes and displacement of the whole plate, (n_nodes, 2), on all ranks."""
    nodes, field = (np.full((measurement.region.n_nodes, 2), np.nan) for _ in range(2))
    for s, q in team.gather_lists([(p.subdomain, q) for p, q in
                                   zip(measurement.parts, measurement.field.q, strict=True)]):
        nodes[s.node_ids], field[s.node_ids] = s.mesh.nodes, q.reshape(-1, 2)
    return nodes, field


def _monolithic(folder: Path, plate: Plate, noise: float = 0.0) -> NDArray[np.float64]:
    """The field that rank 0 finds on one domain, on all ranks."""
    path = _write(folder, plate, MONOLITHIC + TIGHT + plate.regularization, noise)
    field = None
    if MPI.COMM_WORLD.rank == 0:
        alone = Team(MPI.COMM_SELF)
        field = _field(alone, _measure(alone, path))[1]
    return np.asarray(MPI.COMM_WORLD.bcast(field))


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt((values**2).mean()))


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("plate", "solver"), [(CORNER, BLOCKS), (CORNER, METIS), (MIDDLE, BLOCKS), (MIDDLE, METIS)],
                         ids=["corner in blocks", "corner by METIS", "middle in blocks", "middle by METIS"])
def test_blank_quarter(shared_path: Path, plate: Plate, solver: str) -> None:
    team = Team(MPI.COMM_WORLD)
    monolithic = _monolithic(shared_path, plate)
    ears = Ears()
    measured = _measure(team, _write(shared_path, plate, solver + TIGHT + plate.regularization), ears)
    nodes, field = _field(team, measured)
    assert np.abs(field - monolithic).max() <= SAME_PX
    assert measured.field.largest_jump <= SAME_PX
    error = field - plate.field.displacement(nodes)
    textured = _contrast(nodes, plate.blank) > 0.0
    assert 0.6 < textured.mean() < 0.9
    # The cubic's bias is up to 1.4e-3 px per pixel, rounding to 8 bit adds 1e-3 px on cells of 256 pixels; the field
    # is an equilibrium, so that mechanics carry it on into the blank part.
    assert _rms(error[textured]) <= 3e-3
    assert _rms(error) <= 3e-3
    note = next(n for n in ears.notes if n.startswith("partition: "))
    if solver == BLOCKS:
        listed = ", ".join(str(s) for s in plate.blocks)
        assert note == (f"partition: 4 of 16 subdomains without texture ({listed}); 4 joined a neighbour, "
                        "12 are left")
        assert measured.setting.n_subdomains == 12
    else:
        # A quarter of 13, of which those on the border hold some texture and stay, or lose a piece that hangs on the
        # rest by a node (in the middle one), without which nothing holds it.
        assert 9 <= measured.setting.n_subdomains <= 13
    assert measured.notes[0] == note
    assert [s for owned in team.comm.allgather([p.subdomain.index for p in measured.parts])
            for s in owned] == list(range(measured.setting.n_subdomains))


@pytest.mark.parallel(4)
def test_the_assembled_operator_needs_no_texture_in_every_subdomain(shared_path: Path) -> None:
    # As many subdomains as ranks, of which the last is blank: none may join another.
    team = Team(MPI.COMM_WORLD)
    monolithic = _monolithic(shared_path, CORNER)
    solver = '[solver]\nmethod = "assembled"\npartition = "blocks"\nblocks = [2, 2]\n'
    measured = _measure(team, _write(shared_path, CORNER, solver + TIGHT + CORNER.regularization))
    assert measured.setting.n_subdomains == 4
    assert np.abs(_field(team, measured)[1] - monolithic).max() <= SAME_PX


@pytest.mark.parallel(RANKS)
def test_noise_is_no_texture(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    monolithic = _monolithic(shared_path, MIDDLE, noise=2.0)
    path = _write(shared_path, MIDDLE, BLOCKS + TIGHT + MIDDLE.regularization, noise=2.0)
    measured = _measure(team, path)
    assert measured.setting.n_subdomains == 12
    assert np.abs(_field(team, measured)[1] - monolithic).max() <= SAME_PX


HIDDEN = Plate((-200.0, -200.0, -100.0, -100.0), MIDDLE.field, MIDDLE.not_controlled, (5,))
"""Texture everywhere, block 5 hidden in the deformed image."""


def _hidden(folder: Path) -> Path:
    if MPI.COMM_WORLD.rank == 0:
        mask = np.ones((SIDE, SIDE), dtype=np.uint8)
        mask[70:138, 70:138] = 0  # 80 to 128 and what its pixels reach
        tifffile.imwrite(folder / "mask.tif", mask)
    return _write(folder, HIDDEN, BLOCKS + TIGHT + HIDDEN.regularization, images='deformed_mask = "mask.tif"')


@pytest.mark.parallel(RANKS)
def test_pixels_hidden_in_the_deformed_image_are_no_texture(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    measured = _measure(team, _hidden(shared_path))
    assert "1 of 16 subdomains without texture (5)" in measured.notes[0]
    assert 48**2 < measured.setting.n_pixels - measured.grey[0].n_pixels < 70**2
    nodes, field = _field(team, measured)
    assert _rms(field - HIDDEN.field.displacement(nodes)) <= 3e-3


@pytest.mark.parallel(RANKS)
def test_start_and_hidden_pixels_move_along(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    case = load_case(_hidden(shared_path)).case
    pair = open_pair(case)
    mesh = build_mesh(case, SIDE, SIDE) if team.is_root else None
    subdomains, region = share_out(team, case, mesh)
    found = coarse_task(team, case, pair, mesh)()
    start = coarse_field(team, case, found, [s.mesh.nodes for s in subdomains])
    parts = seen_parts(own_parts(subdomains, pair, 3), start.q)
    given = Correlated(parts, correlate(team, parts), region, start)
    joined = with_texture(team, case, pair, mesh, given)
    merged, region, moved = joined.parts, joined.region, joined.start
    for part, hessian in zip(merged, joined.hessians, strict=True):
        np.testing.assert_array_equal(hessian.diagonal(), part.view.correlation.assemble_hessian().diagonal())
    expected = coarse_field(team, case, found, [p.subdomain.mesh.nodes for p in merged])
    assert region.n_subdomains == 15
    assert len(merged) == len(moved.q) > 0
    for found, wanted in zip(moved.q, expected.q, strict=True):
        np.testing.assert_array_equal(found, wanted)
    assert moved.notes[1:] == start.notes
    before, after = (sum(team.gather_lists([p.view.correlation.n_usable_pixels for p in which]))
                     for which in (parts, merged))
    assert before == after < 192**2 - 48**2


@pytest.mark.parallel(RANKS)
def test_the_whole_run_knows_the_new_subdomains(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    summary = run_case(team, _write(shared_path, CORNER, BLOCKS + CORNER.regularization), Ears())
    assert summary.n_subdomains == 12
    assert "4 of 16 subdomains without texture" in summary.notes[0]
    if team.is_root:
        result = read_result(shared_path / "result.vtkhdf")
        assert set(result.subdomain_ids) == set(range(12))
        assert result.attributes["provenance"]["n_subdomains"] == 12


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("solver", "regularization"), [
    (BLOCKS, "[regularization]\ncut_off_wavelength = 96.0\n"),
    (METIS, "[regularization]\ncut_off_wavelength = 96.0\n"),
    (BLOCKS, ""),
], ids=["uncontrolled edges, blocks", "uncontrolled edges, METIS", "FE-DIC"])
def test_a_blank_part_that_nothing_holds_is_singular(shared_path: Path, solver: str, regularization: str) -> None:
    with pytest.raises(SingularSubdomainError, match=r"^subdomain \d+ \(columns .*too little texture") as caught:
        _measure(Team(MPI.COMM_WORLD), _write(shared_path, CORNER, solver + regularization))
    assert is_on_all_ranks(caught.value)


@pytest.mark.parallel([2, 4])
def test_fewer_subdomains_than_ranks_are_refused(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    # As many blocks as ranks, the last without texture.
    plate = Plate((112.0 if team.size == 4 else -200.0, 112.0, 400.0, 400.0), CORNER.field, "[]", ())
    blocks = {2: [1, 2], 4: [2, 2]}[team.size]
    path = _write(shared_path, plate, f'[solver]\npartition = "blocks"\nblocks = {blocks}\n' + plate.regularization)
    with pytest.raises(InputError, match=rf"^1 of {team.size} subdomains hold no texture.*start at most "
                                         rf"{team.size - 1} ranks or ask for more subdomains") as caught:
        _measure(team, path)
    assert is_on_all_ranks(caught.value)

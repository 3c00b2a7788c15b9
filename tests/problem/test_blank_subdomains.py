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
from ddic.errors import InputError, SingularSubdomainError, is_collective
from ddic.inputs.inputs import open_inputs
from ddic.io.result_reader import read_result
from ddic.methods.run import run_case
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.problem.reference_problem import build_whole_mesh, prepare_reference
from ddic.results.measurement import Measurement
from ddic.synth.fields import Affine
from support.cases import Ears, write_case, write_images
from support.measuring import field_on_one_rank, measure, subdomain_numbers, whole_field
from support.near_far_cases import case_text as near_far_text
from support.near_far_cases import near_section, write_pairs

RANKS = [1, 3]
SIDE = 256
REGION = "region = [32, 32, 224, 224]"
"""12 x 12 cells of 16 px, 4 x 4 blocks of 48 px; l_c is half of it."""

FADE = 16.0
"""Width over which the texture fades out, so that the deformed image knows where at any fraction of a pixel."""

KEEP = '[correlation]\nspoilt_pixels = "keep"\n'
"""Cells at the rim of what is blank are excluded or not as the first fields show them, which starts make different."""

TIGHT = "[gauss_newton]\ntolerance = 1e-10\nrms_tolerance = 1e-11\n"
BLOCKS = '[solver]\nmethod = "dual"\npartition = "blocks"\nblocks = [4, 4]\ntolerance = 1e-12\n'
METIS = '[solver]\nmethod = "dual"\nsubdomains = 13\ntolerance = 1e-12\n'
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


def _field(measurement: Measurement) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Nodes and displacement of the whole plate, (n_nodes, 2), on all ranks."""
    nodes = np.full((measurement.region.n_nodes, 2), np.nan)
    for s in measurement.team.gather_lists(measurement.subdomains):
        nodes[s.node_ids] = s.mesh.nodes
    return nodes, whole_field(measurement)


def _monolithic(folder: Path, plate: Plate, noise: float = 0.0) -> NDArray[np.float64]:
    """The field that rank 0 finds on one domain, on all ranks."""
    path = _write(folder, plate, MONOLITHIC + TIGHT + KEEP + plate.regularization, noise)
    return field_on_one_rank(path)


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt((values**2).mean()))


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("plate", "solver"), [(CORNER, BLOCKS), (CORNER, METIS), (MIDDLE, BLOCKS), (MIDDLE, METIS)],
                         ids=["corner in blocks", "corner by METIS", "middle in blocks", "middle by METIS"])
def test_blank_quarter(shared_path: Path, plate: Plate, solver: str) -> None:
    team = Team(MPI.COMM_WORLD)
    monolithic = _monolithic(shared_path, plate)
    ears = Ears()
    measured = measure(team, _write(shared_path, plate, solver + TIGHT + KEEP + plate.regularization), ears)
    nodes, field = _field(measured)
    assert np.abs(field - monolithic).max() <= SAME_PX
    assert measured.largest_jump <= SAME_PX
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
        assert measured.size.n_subdomains == 12
    else:
        # A quarter of 13, of which those on the border hold some texture and stay, or lose a piece that hangs on the
        # rest by a node (in the middle one), without which nothing holds it.
        assert 9 <= measured.size.n_subdomains <= 13
    assert measured.notes[0] == note
    assert subdomain_numbers(measured) == list(range(measured.size.n_subdomains))


@pytest.mark.parallel([3])
def test_the_assembled_operator_needs_no_texture_in_every_subdomain(shared_path: Path) -> None:
    # As many subdomains as ranks, of which the last is blank: none may join another.
    team = Team(MPI.COMM_WORLD)
    monolithic = _monolithic(shared_path, CORNER)
    solver = '[solver]\nmethod = "assembled"\npartition = "blocks"\nblocks = [2, 2]\n'
    measured = measure(team, _write(shared_path, CORNER, solver + TIGHT + KEEP + CORNER.regularization))
    assert measured.size.n_subdomains == 4
    assert np.abs(_field(measured)[1] - monolithic).max() <= SAME_PX


@pytest.mark.parallel(RANKS)
def test_noise_is_no_texture(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    monolithic = _monolithic(shared_path, MIDDLE, noise=2.0)
    path = _write(shared_path, MIDDLE, BLOCKS + TIGHT + KEEP + MIDDLE.regularization, noise=2.0)
    measured = measure(team, path)
    assert measured.size.n_subdomains == 12
    assert np.abs(_field(measured)[1] - monolithic).max() <= SAME_PX


HIDDEN = Plate((-200.0, -200.0, -100.0, -100.0), MIDDLE.field, MIDDLE.not_controlled, (5,))
"""Texture everywhere, block 5 hidden in the deformed image."""


def _hidden(folder: Path) -> Path:
    if MPI.COMM_WORLD.rank == 0:
        mask = np.ones((SIDE, SIDE), dtype=np.uint8)
        mask[70:138, 70:138] = 0  # 80 to 128 and what its pixels reach
        tifffile.imwrite(folder / "mask.tif", mask)
    return _write(folder, HIDDEN, BLOCKS + TIGHT + HIDDEN.regularization, images='deformed_mask = "mask.tif"')


@pytest.mark.parallel(RANKS)
def test_pixels_hidden_in_the_deformed_image_blank_no_subdomain(shared_path: Path) -> None:
    # A subdomain is blank because the reference says so; what a frame hides renews M of the subdomains that lose it.
    team = Team(MPI.COMM_WORLD)
    measured = measure(team, _hidden(shared_path))
    assert measured.size.n_subdomains == 16
    assert not any(note.startswith("partition: ") for note in measured.notes)
    # The mask reaches 10 of 48 px into the blocks at each side of block 5, and 10 x 10 px into those at its corners;
    # with what is interpolated from its pixels that is 68 + 3 px.
    renewed = next(note for note in measured.notes if "are renewed" in note)
    assert renewed.startswith("9 subdomains (0, 1, 2, 4, 5, 6, 8, 9, 10) lost or gained more pixels")
    assert measured.size.n_pixels - measured.evaluation.grey[0].n_pixels == 71**2
    nodes, field = _field(measured)
    assert _rms(field - HIDDEN.field.displacement(nodes)) <= 3e-3


@pytest.mark.parallel(RANKS)
def test_joined_subdomains_have_their_pixels_and_their_m(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    inputs, _ = open_inputs(team, load_case(_write(shared_path, CORNER, BLOCKS + CORNER.regularization)))
    region_mesh = build_whole_mesh(team, inputs)
    problem, _ = prepare_reference(team, inputs, region_mesh, PhaseClock())
    assert problem.region.n_subdomains == 12
    assert team.gather_lists([s.index for s in problem.subdomains]) == list(range(12))
    for (own,), (hessian,) in zip(problem.views, problem.hessians, strict=True):
        np.testing.assert_array_equal(hessian.toarray(), own.assemble_hessian().toarray())
    cells = np.concatenate(team.gather_lists([s.cell_ids for s in problem.subdomains]))
    assert sorted(cells.tolist()) == list(range(144))
    # Columns 32 to 223 or 224 of as many rows, whichever the fill rule gives the edges.
    assert problem.n_pixels in {192**2, 192 * 193, 193**2}
    n_pixels = team.gather_lists([own.n_pixels for own, in problem.views])
    assert sum(n_pixels) == problem.n_pixels


@pytest.mark.parallel(RANKS)
def test_blank_subdomains_of_several_cameras_join_neighbours_of_their_own(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    if team.is_root:
        write_pairs(shared_path)
        for name in ("far_reference", "far_deformed"):
            image = tifffile.imread(shared_path / f"{name}.tif")
            pixels = np.stack(np.meshgrid(np.arange(image.shape[1]), np.arange(image.shape[0])), axis=-1).astype(float)
            contrast = _contrast(pixels, (-100.0, -100.0, 64.0, 300.0))
            tifffile.imwrite(shared_path / f"{name}.tif", (128.0 + (image - 128.0) * contrast).astype(np.float32))
    team.wait_for_all()
    measured = {}
    for method in ("dual", "assembled"):
        solver = f'[solver]\nmethod = "{method}"\npartition = "blocks"\nblocks = [5, 4]\ntolerance = 1e-12\n'
        more = '[regularization]\ncut_off_wavelength = 80.0\nnot_controlled = []\n' + solver + TIGHT
        if team.is_root:
            text = near_far_text(near_section(more="noise = 0.5"), images="noise = 0.5", more=more)
            (shared_path / "case.toml").write_text(text, encoding="utf-8")
        team.wait_for_all()
        measured[method] = measure(team, shared_path / "case.toml")
    note = measured["dual"].notes[0]
    # Texture begins at column 64; blocks of 40 px from column 20 on: the first of each of four rows hold none.
    assert note.startswith("partition: 4 of "), note
    assert note.endswith(f"4 joined a neighbour, {measured['dual'].size.n_subdomains} are left")
    assert measured["dual"].size.n_subdomains == measured["assembled"].size.n_subdomains - 4
    cells = team.gather_lists([(s.camera, s.index) for s in measured["dual"].subdomains])
    assert sorted({camera for camera, _ in cells}) == [0, 1]
    difference = whole_field(measured["dual"]) - whole_field(measured["assembled"])
    assert np.abs(difference).max() <= SAME_PX


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
    (BLOCKS, "[regularization]\ncut_off_wavelength = 96.0\nedge_wavelength = 0\n"),
    (METIS, "[regularization]\ncut_off_wavelength = 96.0\nedge_wavelength = 0\n"),
    (BLOCKS, ""),
], ids=["uncontrolled edges, blocks", "uncontrolled edges, METIS", "FE-DIC"])
def test_a_blank_part_that_nothing_holds_is_singular(shared_path: Path, solver: str, regularization: str) -> None:
    with pytest.raises(SingularSubdomainError, match=r"^subdomain \d+ \(columns .*too little texture") as caught:
        measure(Team(MPI.COMM_WORLD), _write(shared_path, CORNER, solver + KEEP + regularization))
    assert is_collective(caught.value)


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("regularized", [False, True], ids=["FE-DIC", "uncontrolled edges"])
def test_a_blank_part_that_nothing_holds_is_left_out(shared_path: Path, regularized: bool) -> None:
    regularization = "[regularization]\ncut_off_wavelength = 96.0\n" if regularized else ""
    measured = measure(Team(MPI.COMM_WORLD), _write(shared_path, CORNER, BLOCKS + regularization))
    nodes, field = _field(measured)
    x0, y0, x1, y1 = CORNER.blank
    inside = (nodes > (x0 + 8, y0 + 8)).all(axis=1) & (nodes < (x1 - 8, y1 - 8)).all(axis=1)
    beside = (nodes > (x0 - 24, y0 - 24)).all(axis=1) & (nodes < (x1 + 24, y1 + 24)).all(axis=1)
    assert np.isnan(field[inside]).all() == (not regularized)
    error = np.abs(field - CORNER.field.displacement(nodes))
    # Grey levels are rounded; free of noise.
    assert error[~beside].max() <= 0.02


@pytest.mark.parallel([2, 4])
def test_fewer_subdomains_than_ranks_are_refused(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    # As many blocks as ranks, the last without texture.
    plate = Plate((112.0 if team.size == 4 else -200.0, 112.0, 400.0, 400.0), CORNER.field, "[]", ())
    blocks = {2: [1, 2], 4: [2, 2]}[team.size]
    solver = f'[solver]\nmethod = "dual"\npartition = "blocks"\nblocks = {blocks}\n'
    path = _write(shared_path, plate, solver + plate.regularization)
    with pytest.raises(InputError, match=rf"^1 of {team.size} subdomains hold no texture.*start at most "
                                         rf"{team.size - 1} ranks or ask for more subdomains") as caught:
        measure(team, path)
    assert is_collective(caught.value)

"""FE-DIC and R-DIC by domain decomposition, from images to a continuous field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from mpi4py import MPI

from ddic.errors import ConvergenceError, SingularSubdomainError, is_collective
from ddic.parallel.team import Team
from ddic.synth.fields import Translation
from support.cases import WAVES, Ears, write_case, write_images
from support.measuring import field_on_one_rank, measure, subdomain_numbers, whole_field
from support.pictures import rms_error

RANKS = [1, 2, 3, 4]
# Gauss-Newton to 1e-10, Krylov to 1e-12: what is left between two ways of adding up is far below 1e-8 px.
SAME_PX = 1e-8
TIGHT = """
[gauss_newton]
tolerance = 1e-10
rms_tolerance = 0.0
"""
NO_START = "[start]\nrigid = false\npyramid = false\nindependent = false\n"
REGULARIZED = "[regularization]\ncut_off_wavelength = 48.0\n"
TIGHT_SOLVER = '[solver]\nmethod = "dual"\nsubdomains = 8\ntolerance = 1e-12\n'


def _images(folder: Path, **options: object) -> None:
    if MPI.COMM_WORLD.rank == 0:
        write_images(folder, **options)
    MPI.COMM_WORLD.barrier()


def _case(folder: Path, more: str, **sections: str) -> Path:
    if MPI.COMM_WORLD.rank == 0:
        write_case(folder, more, **sections)
    MPI.COMM_WORLD.barrier()
    return folder / "case.toml"


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("regularization", ["", REGULARIZED], ids=["FE-DIC", "R-DIC"])
def test_field_depends_neither_on_ranks_nor_on_the_decomposition(shared_path: Path, regularization: str) -> None:
    _images(shared_path)
    team = Team(MPI.COMM_WORLD)
    path = _case(shared_path, TIGHT_SOLVER + TIGHT + NO_START + regularization)
    measured = measure(team, path)
    field = whole_field(measured)
    one_rank = field_on_one_rank(path)
    path = _case(shared_path, '[solver]\nmethod = "monolithic"\n' + TIGHT + NO_START + regularization)
    monolithic = field_on_one_rank(path)
    assert measured.subdomains
    assert subdomain_numbers(measured) == list(range(8))
    assert np.abs(field - one_rank).max() <= SAME_PX
    assert np.abs(field - monolithic).max() <= SAME_PX
    assert measured.largest_jump <= SAME_PX
    assert measured.size.n_interface > 0


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("regularization", ["", REGULARIZED], ids=["FE-DIC", "R-DIC"])
@pytest.mark.parametrize("method", ["assembled", "conjugate_gradient"])
def test_the_whole_operator_leads_to_the_same_field(shared_path: Path, method: str, regularization: str) -> None:
    _images(shared_path)
    team = Team(MPI.COMM_WORLD)
    solver = f'[solver]\nmethod = "{method}"\nsubdomains = 8\ntolerance = 1e-12\n'
    path = _case(shared_path, solver + TIGHT + regularization)
    measured = measure(team, path)
    field = whole_field(measured)
    path = _case(shared_path, '[solver]\nmethod = "monolithic"\n' + TIGHT + NO_START + regularization)
    assert np.abs(field - field_on_one_rank(path)).max() <= SAME_PX
    # Copies of a node hold one number, to the rounding of q + (qbar + dqbar - q).
    assert measured.largest_jump <= 1e-12
    assert (measured.size.n_subdomains, measured.size.n_interface) == (8, 0)


@pytest.mark.parallel(RANKS)
def test_the_default_start_leads_to_the_same_field(shared_path: Path) -> None:
    _images(shared_path)
    team = Team(MPI.COMM_WORLD)
    ears = Ears()
    field = whole_field(measure(team, _case(shared_path, TIGHT_SOLVER + TIGHT + REGULARIZED), ears))
    reference = field_on_one_rank(_case(shared_path, TIGHT_SOLVER + TIGHT + REGULARIZED + NO_START))
    # Gauss-Newton has one solution near both starts, to the tolerance of 1e-10.
    assert np.abs(field - reference).max() <= SAME_PX
    said = ("rigid shift", "pyramid", "independent", "stopped at")
    assert all(word in note for word, note in zip(said, ears.notes, strict=True))


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("solver", [
    '[solver]\nmethod = "dual"\npartition = "blocks"\nblocks = [2, 2]\n',
    '[solver]\nsubdomains = 5\nweighting = "paper"\npreconditioner = "paper"\n',
    '[solver]\nsubdomains = 4\npreconditioner = "none"\n',
], ids=["blocks", "paper", "no preconditioner"])
@pytest.mark.parametrize("regularization", ["", REGULARIZED], ids=["FE-DIC", "R-DIC"])
def test_known_displacement(shared_path: Path, solver: str, regularization: str) -> None:
    _images(shared_path)
    team = Team(MPI.COMM_WORLD)
    ears = Ears()
    measured = measure(team, _case(shared_path, solver + regularization), ears)
    errors = [rms_error(u, s.mesh.nodes, WAVES)
              for s, u in zip(measured.subdomains, measured.displacements, strict=True)]
    # Bilinear cells of 16 px miss these waves by up to (2 pi 16/256)^2 / 8 x 0.5 = 1e-2 px; the waves are no
    # elastic equilibrium, so that regularization costs as much again at the region's edges.
    assert max(errors) <= (2e-2 if regularization else 1e-2)
    assert ears.sizes == [measured.size]
    assert [r.number for r in ears.records] == list(range(1, len(ears.records) + 1))
    # Krylov to 1e-6 leaves jumps of a millionth of a pixel or so.
    assert measured.largest_jump <= 1e-4


@pytest.mark.parallel(RANKS)
def test_size_counts_the_whole_region(shared_path: Path) -> None:
    _images(shared_path)
    team = Team(MPI.COMM_WORLD)
    size = measure(team, _case(shared_path, TIGHT_SOLVER + REGULARIZED)).size
    assert (size.n_unknowns, size.n_cells, size.n_subdomains, size.n_ranks) == (200, 81, 8, team.size)
    assert size.n_pixels in {144**2, 145**2, 144 * 145}
    assert 100 < size.dynamic_range <= 255
    assert size.eta > 0


@pytest.mark.parallel(RANKS)
def test_identical_images_converge_at_once(shared_path: Path) -> None:
    _images(shared_path)
    measured = measure(Team(MPI.COMM_WORLD), _case(shared_path, TIGHT_SOLVER + REGULARIZED, deformed="f.tif"))
    assert len(measured.records) == 1
    # The spline returns a pixel's value to float32 rounding.
    assert max(np.abs(q).max() for q in measured.q) < 1e-6


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("correction", "gain"), [("global", 0.8), ("element", 1.0)])
def test_grey_correction_is_one_for_all_ranks(shared_path: Path, correction: str, gain: float) -> None:
    if MPI.COMM_WORLD.rank == 0:
        write_images(shared_path)
        f = tifffile.imread(shared_path / "f.tif")
        tifffile.imwrite(shared_path / "dim.tif", ((f - 20.0) / 0.8).astype(np.float32))  # f = 0.8 g + 20
    MPI.COMM_WORLD.barrier()
    more = f'[correlation]\ngrey_correction = "{correction}"\n' + TIGHT_SOLVER
    measured = measure(Team(MPI.COMM_WORLD), _case(shared_path, more, deformed="dim.tif"))
    # Without displacement nothing is interpolated: what is left is float32 rounding.
    assert measured.evaluation.grey[0].gain == pytest.approx(gain, abs=1e-5)
    assert measured.evaluation.grey[0].residual_std < 1e-3
    assert max(np.abs(q).max() for q in measured.q) < 1e-4


@pytest.mark.parallel(RANKS)
def test_non_convergence_is_raised_on_all_ranks(shared_path: Path) -> None:
    _images(shared_path)
    path = _case(shared_path, TIGHT_SOLVER + "[gauss_newton]\nmax_iterations = 1\n" + NO_START)
    with pytest.raises(ConvergenceError, match="did not converge in 1 iterations") as caught:
        measure(Team(MPI.COMM_WORLD), path)
    assert is_collective(caught.value)


@pytest.mark.parallel(RANKS)
def test_a_subdomain_without_texture_is_named_on_all_ranks(shared_path: Path) -> None:
    if MPI.COMM_WORLD.rank == 0:
        write_images(shared_path)
        f = tifffile.imread(shared_path / "f.tif")
        f[90:, 90:] = 128
        tifffile.imwrite(shared_path / "f.tif", f)
    MPI.COMM_WORLD.barrier()
    path = _case(shared_path, '[solver]\nmethod = "dual"\npartition = "blocks"\nblocks = [2, 2]\n'
                              '[correlation]\nspoilt_pixels = "keep"\n')
    with pytest.raises(SingularSubdomainError, match=r"^subdomain 3 \(columns 88 to 168, rows 88 to 168\).*"
                                                     "too little texture") as caught:
        measure(Team(MPI.COMM_WORLD), path)
    assert is_collective(caught.value)


@pytest.mark.parallel(RANKS)
def test_a_shift_larger_than_the_windows_is_followed(shared_path: Path) -> None:
    field = Translation((-21.0, 18.0))
    _images(shared_path, displacement=field, side=224)
    measured = measure(Team(MPI.COMM_WORLD), _case(shared_path, TIGHT_SOLVER, region="region = [40, 40, 184, 184]"))
    # A whole number of pixels: grey levels match exactly, up to the rest of the last correction.
    assert max(rms_error(u, s.mesh.nodes, field)
               for s, u in zip(measured.subdomains, measured.displacements, strict=True)) <= 2e-4
    assert measured.evaluation.grey[0].n_pixels == measured.size.n_pixels


@pytest.mark.parallel(RANKS)
def test_pixels_that_leave_the_image_are_counted(shared_path: Path) -> None:
    _images(shared_path, displacement=Translation((10.0, 0.0)))
    team = Team(MPI.COMM_WORLD)
    measured = measure(team, _case(shared_path, TIGHT_SOLVER, region="region = [47, 24, 191, 168]"))
    lost = measured.size.n_pixels - measured.evaluation.grey[0].n_pixels
    # Ten columns, or eleven with a shift a hair above 10 px, of 144 or 145 rows.
    assert 9 * 144 <= lost <= 11 * 145

"""PGD-DIC from a case file to the result file, on any number of ranks, and its sessions."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from mpi4py import MPI

import ddic
from ddic.case.loader import load_case
from ddic.errors import ConvergenceError, InputError, is_collective
from ddic.inputs.inputs import open_inputs
from ddic.methods.pgd_dic import SeparatedMeasurement, SeparatedSession
from ddic.methods.run import run_case
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from support.cases import WAVES, Ears, write_case, write_images
from support.pictures import rms_error_at

RANKS = [1, 3]
PGD = "[pgd]\n"
REGULARIZED = "[regularization]\ncut_off_wavelength = 48.0\n"
POINTS = np.random.default_rng(0).uniform(24, 168, (500, 2))


def _write(folder: Path, more: str = PGD, **sections: str) -> Path:
    if MPI.COMM_WORLD.rank == 0:
        write_images(folder)
        write_case(folder, more, **sections)
    MPI.COMM_WORLD.barrier()
    return folder / "case.toml"


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("update", ["true", "false"])
def test_result_does_not_depend_on_ranks_to_the_last_bit(shared_path: Path, update: str) -> None:
    path = _write(shared_path, f"{REGULARIZED}[pgd]\nupdate = {update}\n")
    team = Team(MPI.COMM_WORLD)
    summary = run_case(team, path, Silence())
    team.comm.barrier()
    found = ddic.open(shared_path / "result.vtkhdf")
    alone = None
    if team.is_root:
        own = shared_path / "alone"
        own.mkdir()
        write_images(own)
        run_case(Team.alone(), write_case(own, f"{REGULARIZED}[pgd]\nupdate = {update}\n"), Silence())
        alone = ddic.open(own / "result.vtkhdf")
    alone = team.broadcast(alone)
    assert np.array_equal(found.displacement, alone.displacement)
    assert np.array_equal(found.separated.x, alone.separated.x)
    assert np.array_equal(found.separated.y, alone.separated.y)
    assert np.array_equal(found.corrections["gain"], alone.corrections["gain"])
    assert summary.n_ranks == team.size
    assert summary.iterations == len(found.corrections["gain"])


@pytest.mark.parallel(RANKS)
def test_result_file_holds_products_cells_and_residual(shared_path: Path) -> None:
    path = _write(shared_path, f"{REGULARIZED}[pgd]\noutput_spacing = 48\n")
    team, ears = Team(MPI.COMM_WORLD), Ears()
    summary = run_case(team, path, ears)
    team.comm.barrier()
    result = ddic.open(shared_path / "result.vtkhdf")
    assert result.mesh.n_cells == 9
    assert (summary.n_dofs, summary.n_pixels, summary.n_modes) == (200, 144 * 144, result.separated.n_modes)
    # Nodes of the cells are nodes of the elements; in between products are finer than the cells.
    assert np.allclose(result.at(result.mesh.nodes), result.displacement, rtol=0, atol=1e-13)
    error = result.at(POINTS) - WAVES.displacement(POINTS)
    # Waves of 256 px on 16-px elements, and a cut-off of 48 px.
    assert np.sqrt((error**2).mean()) <= 0.01
    assert [r.number for r in ears.corrections] == result.corrections["correction"].tolist()
    image = result.residual_image
    assert np.isfinite(image).sum() == 144 * 144
    assert np.isfinite(image[24:168, 24:168]).all()
    assert summary.residual_std_grey == pytest.approx(float(np.nanstd(image)), rel=1e-3)
    cells = image[24:168, 24:168].astype(float).reshape(3, 48, 3, 48)
    rms = np.sqrt((cells**2).mean(axis=(1, 3))).ravel()
    assert np.allclose(result.cell_data["residual_rms"], rms, rtol=1e-6)
    assert (result.cell_data["residual_n_pixels"] == 48 * 48).all()
    assert not result.cell_data["doubtful"].any()
    stored = json.loads((shared_path / "result.json").read_text())
    assert stored["n_modes"] == summary.n_modes


@pytest.mark.parallel([1, 3])
def test_mask_leaves_pixels_out(shared_path: Path) -> None:
    path = _write(shared_path, "[pgd]\noutput_spacing = 16\n", images='reference_mask = "mask.tif"')
    if MPI.COMM_WORLD.rank == 0:
        mask = np.full((192, 192), 255, np.uint8)
        mask[70:125, 70:125] = 0
        tifffile.imwrite(shared_path / "mask.tif", mask)
    MPI.COMM_WORLD.barrier()
    summary = run_case(Team(MPI.COMM_WORLD), path, Silence())
    MPI.COMM_WORLD.barrier()
    result = ddic.open(shared_path / "result.vtkhdf")
    # The mask, and what a slope is taken from it: one pixel around, without the corners.
    assert summary.n_pixels == 144 * 144 - 55 * 55 - 4 * 55
    hidden = result.cell_data["residual_n_pixels"] == 0
    assert hidden.sum() == 9
    assert result.cell_data["doubtful"][hidden].all()
    x, y = POINTS.T
    seen = ~((x > 60) & (x < 140) & (y > 60) & (y < 140))
    assert rms_error_at(result, WAVES, POINTS[seen]) <= 0.01


@pytest.mark.parallel([1, 3])
def test_session_measures_frames_in_turn(shared_path: Path) -> None:
    path = _write(shared_path)
    team = Team(MPI.COMM_WORLD)
    inputs, frame = open_inputs(team, load_case(path))
    with SeparatedSession(team, inputs, Silence(), PhaseClock()) as session:
        first = session.measure(frame)
        still = session.measure((inputs.cameras[0].reference,))
        again = session.measure(frame, first.unknowns)
    assert np.array_equal(first.unknowns.at(POINTS), session_of(team, path).unknowns.at(POINTS))
    # Identical images are the same at rest.
    assert np.abs(still.unknowns.at(POINTS)).max() <= 1e-4
    assert len(again.solution.records) <= 1
    # A further correction of the same images is one that was not worth it.
    assert np.abs(again.unknowns.at(POINTS) - first.unknowns.at(POINTS)).max() <= 0.01


def session_of(team: Team, path: Path) -> SeparatedMeasurement:
    inputs, frame = open_inputs(team, load_case(path))
    with SeparatedSession(team, inputs, Silence(), PhaseClock()) as session:
        return session.measure(frame)


@pytest.mark.parallel([1, 3])
def test_start_from_an_earlier_result_of_either_method(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    for name, more in (("products", PGD), ("nodes", '[solver]\nmethod = "assembled"\n')):
        path = _write(shared_path, more)
        run_case(team, path, Silence())
        team.comm.barrier()
        if team.is_root:
            (shared_path / "result.vtkhdf").rename(shared_path / f"{name}.vtkhdf")
        team.comm.barrier()
        path = _write(shared_path, f'{PGD}[start]\nfrom_result = "{name}.vtkhdf"\n')
        ears = Ears()
        summary = run_case(team, path, ears)
        assert summary.iterations <= 1
        assert any(f"start: displacement of {shared_path.resolve() / name}" in note for note in ears.notes)
        team.comm.barrier()
        assert rms_error_at(ddic.open(shared_path / "result.vtkhdf"), WAVES, POINTS) <= 0.01


@pytest.mark.parallel([1, 3])
def test_failures_are_raised_on_all_ranks(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    path = _write(shared_path, "[pgd]\nmax_corrections = 1\nstop_at_noise = false\n[start]\npyramid = false\n")
    with pytest.raises(ConvergenceError, match="PGD-DIC does not converge") as caught:
        run_case(team, path, Silence())
    assert is_collective(caught.value)
    path = _write(shared_path, images='reference_mask = "mask.tif"')
    if team.is_root:
        tifffile.imwrite(shared_path / "mask.tif", np.zeros((192, 192), np.uint8))
    team.comm.barrier()
    with pytest.raises(InputError, match="the mask leaves 0 px") as refused:
        run_case(team, path, Silence())
    assert is_collective(refused.value)


def test_tikhonov_measures_the_waves(tmp_path: Path) -> None:
    path = _write(tmp_path, '[regularization]\noperator = "tikhonov"\ncut_off_wavelength = 64.0\n[pgd]\n',
                  region="region = [24, 24, 168, 168]")
    summary = run_case(Team.alone(), path, Silence())
    result = ddic.open(tmp_path / "result.vtkhdf")
    assert summary.half_amplitudes.shear == summary.half_amplitudes.longitudinal == 64.0
    # A wave of 200 px keeps 1 / (1 + (64 / 200)^2) = 0.91 of its amplitude of 0.5 px.
    assert rms_error_at(result, WAVES, POINTS) <= 0.05


def test_given_weight_is_that_of_its_wavelength(tmp_path: Path) -> None:
    by_wavelength = run_case(Team.alone(), _write(tmp_path, REGULARIZED + PGD), Silence())
    given = run_case(Team.alone(), _write(tmp_path, f"[regularization]\neta = {by_wavelength.eta!r}\n{PGD}"), Silence())
    assert given.eta == by_wavelength.eta
    assert given.iterations == by_wavelength.iterations
    # The weight of the edges is found from another wavelength then, and is some per cent another one.
    assert given.residual_std_grey == pytest.approx(by_wavelength.residual_std_grey, rel=1e-3)

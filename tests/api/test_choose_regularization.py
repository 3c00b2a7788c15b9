"""Settings tried on a pair and on virtual images made from it."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from mpi4py import MPI
from numpy.typing import NDArray

import ddic
from ddic.cli.studies import sweep
from ddic.errors import InputError
from ddic.inputs.inputs import Inputs
from ddic.methods import sweep as sweeping
from ddic.methods.dd_dic import DecomposedSession
from ddic.parallel.team import Team

SIDE = 200


def wave(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Half a pixel in waves of 60 px."""
    x, y = points.T
    return np.column_stack([np.zeros_like(x), 0.5 * np.cos(2 * np.pi * y / 60)])


@pytest.fixture
def wave_case(shared_path: Path) -> Path:
    path = shared_path / "case.toml"
    if MPI.COMM_WORLD.rank == 0:
        pair = ddic.make_synthetic_pair(wave, (SIDE, SIDE), noise=2.0, seed=3)
        for name, image in zip(("f.tif", "g.tif"), pair, strict=True):
            tifffile.imwrite(shared_path / name, image)
        path.write_text('[images]\nreference = "f.tif"\ndeformed = "g.tif"\n[mesh.structured]\n'
                        f'region = [20, 20, {SIDE - 20}, {SIDE - 20}]\nelement_size = 16\n'
                        '[regularization]\ncut_off_wavelength = 120\n', encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    return path


def test_recommended_settings_are_next_to_the_best(wave_case: Path) -> None:
    told: list[tuple[str, int]] = []
    found = ddic.choose_regularization(wave_case, cut_off_wavelengths=(0, 32, 60, 120), element_sizes=(8, 16, 20),
                                       advance=lambda what, count: told.append((what, count)))
    # 8 px: all four; 16 and 20: those of at least three elements.
    assert len(found.trials) == 4 + 3 + 3
    assert len(told) == 2 * len(found.trials)
    assert {count for _, count in told} == {len(told)}
    assert found.trials[0].candidate == ddic.Candidate(16.0, 120.0)
    errors = np.array([np.sqrt(((trial.displacement - wave(found.points)) ** 2).mean()) for trial in found.trials])
    # Waves of 60 px are lost at l_c = 120 px; noise costs as much without regularization on the smallest elements.
    assert errors.max() > 5 * errors.min()
    assert errors[found.recommended] <= 1.25 * errors.min()
    virtual = np.array([trial.virtual_error for trial in found.trials])
    # Another noise on 100 times 100 px of speckle, and another field than the true one.
    assert (np.abs(np.log(virtual / errors)) < np.log(1.5)).all()
    # 2 grey levels, of which rounding to 8 bits takes or gives a few per cent.
    assert found.camera_noise == pytest.approx(2.0, rel=0.06)


@pytest.mark.parallel([1, 3])
def test_ranks_find_the_same(wave_case: Path) -> None:
    found = ddic.choose_regularization(wave_case, cut_off_wavelengths=(0, 60, 120), element_sizes=(16,))
    of_ranks = MPI.COMM_WORLD.allgather([trial.virtual_error for trial in found.trials])
    assert all(errors == of_ranks[0] for errors in of_ranks)
    assert found.best.candidate == ddic.Candidate(16.0, 0.0)
    # As one rank finds them: Gauss-Newton's tolerance is 1e-4 px.
    expected = [0.2221, 0.0242, 0.1757]
    assert of_ranks[0] == pytest.approx(expected, abs=3e-4)


@pytest.mark.parametrize(("options", "message"), [
    (["--lengths", "a,b"], "--lengths a,b: give numbers"),
    (["--lengths", "-3"], "cut-off wavelengths [-3.0]: give numbers of pixels, at least 0"),
    (["--lengths", "10", "--elements", "16"], "shorter than 3 elements"),
    (["--elements", "0.5"], "at least 1"),
])
def test_impossible_settings_are_refused(wave_case: Path, options: list[str], message: str) -> None:
    told = CliRunner().invoke(sweep, [str(wave_case), *options])
    assert told.exit_code == 2
    assert message in told.output
    assert told.output.count("\n") == 1
    assert not list(wave_case.parent.glob("*.sweep.*"))


def test_candidates_that_are_prepared_twice_find_the_same(wave_case: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings: dict[str, Any] = {"cut_off_wavelengths": (60, 120), "element_sizes": (20,)}
    kept = ddic.choose_regularization(wave_case, **settings)
    monkeypatch.setattr(sweeping, "KEPT_PIXELS", 0)
    opened: list[Inputs] = []
    prepared = sweeping.DecomposedSession

    def prepare(team: Team, inputs: Inputs, *others: Any) -> DecomposedSession:
        opened.append(inputs)
        return prepared(team, inputs, *others)

    monkeypatch.setattr(sweeping, "DecomposedSession", prepare)
    again = ddic.choose_regularization(wave_case, **settings)
    # Twice each, and once more for the truth.
    assert len(opened) == 5
    assert [t.virtual_error for t in again.trials] == [t.virtual_error for t in kept.trials]


def test_of_a_series_the_last_image_is_taken(wave_case: Path) -> None:
    one = ddic.choose_regularization(wave_case, cut_off_wavelengths=(120,), element_sizes=(20,))
    text = wave_case.read_text()
    wave_case.write_text(text.replace('deformed = "g.tif"', 'deformed = ["f.tif", "g.tif"]'))
    last = ddic.choose_regularization(wave_case, cut_off_wavelengths=(120,), element_sizes=(20,))
    # The first image has not moved at all.
    assert np.array_equal(last.trials[0].displacement, one.trials[0].displacement)
    assert np.abs(last.trials[0].displacement).max() > 0.1


def test_other_methods_and_cameras_are_refused(wave_case: Path) -> None:
    text = wave_case.read_text()
    wave_case.write_text(text + "[pgd]\n")
    with pytest.raises(InputError, match="leave"):
        ddic.choose_regularization(wave_case)


def test_command_writes_a_table_and_a_figure(wave_case: Path) -> None:
    told = CliRunner().invoke(sweep, [str(wave_case), "--lengths", "0,60,120", "--elements", "16,3"])
    assert told.exit_code == 0, told.output
    table = wave_case.with_name("case.sweep.csv")
    with table.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    # Elements smaller than speckles measure nothing without regularization, which is told and stops nothing.
    assert [float(row["element_size_px"]) for row in rows] == [3, 3, 3, 16, 16, 16]
    assert [row["recommended"] for row in rows] == ["0", "0", "0", "1", "0", "0"]
    assert [bool(row["failure"]) for row in rows] == [True, False, False, False, False, False]
    assert "recommended: elements of 16 px, no regularization" in told.output
    # Which of the two is a matter of rounding.
    assert re.search(r"not measured: elements of 3 px, no regularization: Gauss-Newton (did not converge|stagnates)",
                     told.output)
    assert "element_size = 16" in told.output
    assert wave_case.with_name("case.sweep.png").stat().st_size > 20_000

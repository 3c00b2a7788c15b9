"""``ddic modes``: a series as few fields times functions of time, found in noise and on any number of ranks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import tifffile
from mpi4py import MPI

from ddic.arrays import Array
from ddic.errors import ConvergenceError, InputError
from ddic.io.result_reader import read_result
from ddic.io.series_reader import read_series
from ddic.methods.material import measure_modes
from ddic.methods.run import run_file
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.synth.fields import DisplacementField
from ddic.synth.render import Digitiser, Picture, Scene, render_pair
from ddic.synth.speckle import SpeckleTexture
from support.commands import ddic

N_FRAMES = 16
TIMES = np.arange(1, N_FRAMES + 1)
AMPLITUDES = np.column_stack([0.6 * np.sin(0.9 * TIMES), 0.05 * TIMES])


@dataclass(frozen=True)
class TwoModes(DisplacementField):
    """A wave and a stretch."""

    amplitudes: Array

    def displacement(self, points: Array) -> Array:
        x, y = points.T
        wave, stretch = self.amplitudes
        return np.column_stack([wave * np.sin(x / 20.0) + stretch * (x - 48.0) / 48.0,
                                wave * np.cos(y / 25.0) - 0.3 * stretch * (y - 48.0) / 48.0])

    def gradient(self, points: Array) -> Array:
        x, y = points.T
        wave, stretch = self.amplitudes
        gradient = np.zeros((len(points), 2, 2))
        gradient[:, 0, 0] = wave / 20.0 * np.cos(x / 20.0) + stretch / 48.0
        gradient[:, 1, 1] = -wave / 25.0 * np.sin(y / 25.0) - 0.3 * stretch / 48.0
        return gradient


CASE = """
[images]
reference = "f.tif"
deformed = "g*.tif"
[mesh.structured]
region = [8, 8, 88, 88]
element_size = 8
{regularization}
[solver]
method = "dual"
subdomains = 4
tolerance = 1e-12
[gauss_newton]
tolerance = 1e-9
rms_tolerance = 1e-7
[output]
file = "{name}.vtkhdf"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = None
    if MPI.COMM_WORLD.rank == 0:
        path = tmp_path_factory.mktemp("modes")
        for k, amplitudes in enumerate(AMPLITUDES):
            pair = render_pair(Scene(SpeckleTexture(3), TwoModes(amplitudes)), Picture(97, 97, Digitiser(8, 2.0, k)))
            tifffile.imwrite(path / f"g{k:02d}.tif", pair.deformed)
            if k == 0:
                tifffile.imwrite(path / "f.tif", pair.reference)
            still = render_pair(Scene(SpeckleTexture(3), TwoModes(np.zeros(2))), Picture(97, 97, Digitiser(8, 2.0, k)))
            tifffile.imwrite(path / f"still{k:02d}.tif", still.deformed)
    return MPI.COMM_WORLD.bcast(path)


def _write(folder: Path, name: str, regularization: str = "") -> Path:
    path = folder / f"{name}.toml"
    path.write_text(CASE.format(name=name, regularization=regularization))
    return path


# Of 16 frames, two modes have an eighth of the noise's variance, and the reference's is in part of them; what mechanics
# hold off is in all frames.
@pytest.mark.parametrize(("regularization", "share"), [("", 0.6), ("[regularization]\ncut_off_wavelength = 24", 0.8)])
def test_frames_together_are_nearer_than_one_by_one(folder: Path, regularization: str, share: float) -> None:
    measure_modes(Team.alone(), _write(folder, "together", regularization), None, Silence())
    run_file(Team.alone(), _write(folder, "single", regularization), Silence())
    together = read_result(folder / "together.vtkhdf")
    # Two, by themselves.
    assert set(together.time_modes) == {"frame", "time", "amplitude_1", "amplitude_2"}
    of_modes, one_by_one = [], []
    for number, frame in enumerate(read_series(folder / "single.vtkhdf"), start=1):
        field = TwoModes(AMPLITUDES[number - 1])
        of_modes.append(together.compute_frame(number) - field.displacement(together.mesh.nodes))
        one_by_one.append(frame.displacement - field.displacement(frame.mesh.nodes))
    assert np.std(of_modes) < share * np.std(one_by_one)
    with pytest.raises(InputError, match="has no modes with a frame 17"):
        together.compute_frame(17)


@pytest.mark.parallel([1, 2, 3])
def test_the_same_on_any_ranks(folder: Path) -> None:
    team = Team.world()
    if team.is_root:
        _write(folder, "spread", "[regularization]\ncut_off_wavelength = 24")
        _write(folder, "alone", "[regularization]\ncut_off_wavelength = 24")
        measure_modes(Team.alone(), folder / "alone.toml", 2, Silence())
    measure_modes(team, folder / "spread.toml", 2, Silence())
    if team.is_root:
        spread, alone = (read_result(folder / f"{name}.vtkhdf") for name in ("spread", "alone"))
        # Four subdomains each: rounding of sums.
        for name, values in alone.time_modes.items():
            np.testing.assert_allclose(spread.time_modes[name], values, rtol=1e-9, atol=1e-9)
    team.wait_for_all()


def test_what_does_not_move_has_no_modes(folder: Path) -> None:
    path = _write(folder, "still")
    path.write_text(path.read_text().replace('"g*.tif"', '"still*.tif"'))
    with pytest.raises(ConvergenceError, match="no mode stands out from noise"):
        measure_modes(Team.alone(), path, None, Silence())


def test_few_frames_and_lines_are_refused(folder: Path) -> None:
    path = _write(folder, "few")
    path.write_text(path.read_text().replace('"g*.tif"', '["g00.tif", "g01.tif"]'))
    with pytest.raises(InputError, match="2 images are too few for modes"):
        measure_modes(Team.alone(), path, None, Silence())
    plastic = _write(folder, "plastic", "[regularization]\ncut_off_wavelength = 24\nyield_strain = 0.01")
    with pytest.raises(InputError, match=r"plastic.toml: regularization.yield_strain goes with ddic run alone"):
        measure_modes(Team.alone(), plastic, None, Silence())


@pytest.mark.program
def test_the_command(folder: Path) -> None:
    done = ddic("modes", _write(folder, "command"), "--number", "2", ranks=2)
    assert done.code == 0, done.errors
    assert "modes: 2 of 16 frames" in done.out

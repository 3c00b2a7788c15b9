"""Every example, run as a user runs it, and its number."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SECONDS = 240
"""Far above the few seconds of an example: a limit for hangs, not for slow machines."""


def run(command: list[str], folder: Path) -> str:
    """Standard output of a command that must succeed, with ddic on the path and the settings of MPI runs."""
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    with_settings = ["bash", "-c", '. "$0" && exec "$@"', str(ROOT / "scripts" / "mpi_env.sh"), *command]
    done = subprocess.run(with_settings, cwd=folder, env=environment, capture_output=True, text=True,
                          timeout=SECONDS, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def run_example(name: str, output: Path) -> str:
    """What an example prints, whose last lines must be those that its page shows."""
    printed = run(["bash", str(ROOT / "examples" / name / "run.sh"), str(output)], output.parent)
    shown = (ROOT / "examples" / name / "printed.txt").read_text(encoding="utf-8")
    last = "\n".join(printed.splitlines()[-len(shown.splitlines()):])
    assert words(last) == words(shown)
    # Another library or partition moves the last digits; a different field would move the first.
    assert numbers(last) == pytest.approx(numbers(shown), rel=0.05)
    return printed


def numbers(text: str) -> list[float]:
    return [float(found) for found in re.findall(r"-?\d+(?:\.\d+)?(?:e[-+]\d+)?", text)]


def words(text: str) -> list[str]:
    return re.findall(r"[A-Za-z]\w*", re.sub(r"\de[-+]\d+", "", text))


def numbers_after(label: str, text: str) -> list[float]:
    """Numbers between a label and the end of its line."""
    line = re.search(rf"^{label}(.*)$", text, re.MULTILINE)
    assert line, text
    return numbers(line[1])


def code_blocks(document: str, language: str) -> list[str]:
    text = (ROOT / document).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Folder in which the demo has left its files in tour/, as the README's tour does, and what it printed."""
    folder = tmp_path_factory.mktemp("demo")
    return folder, run_example("demo", folder / "tour")


def test_demo_error_is_the_noise_floor(tour: tuple[Path, str]) -> None:
    rms, _ = numbers_after("RMS error against the known field: ", tour[1])
    sigma, floor, ratio = numbers_after("noise floor, sigma = ", tour[1])
    assert sigma == 2.0
    # The noise and the images come from one seed, so only rounding moves these.
    assert 0.003 < floor < 0.008
    # What the mesh cannot follow of Kirsch's field, 0.0015 px, adds 4 % in squares; the floor's estimate has 1 %.
    assert ratio < 1.1
    assert rms == pytest.approx(ratio * floor, rel=0.01)


def test_demo_leaves_the_files_of_the_tour(tour: tuple[Path, str]) -> None:
    for name in ("result.vtkhdf", "result.json", "result.residual.vtkhdf"):
        assert (tour[0] / "tour" / name).is_file()
    for kind in ("partition", "deformed", "residual", "krylov"):
        assert (tour[0] / "tour" / "pictures" / f"result.{kind}.png").stat().st_size > 10_000


def test_check_prints_what_the_tour_shows(tour: tuple[Path, str]) -> None:
    shown = next(block for block in code_blocks("README.md", "text") if "ddic check" in block)
    printed = run(["ddic", "check", "tour/case.toml"], tour[0])
    # The result's line ends in a folder of its own.
    assert ([line for line in printed.splitlines() if not line.startswith("result")]
            == [line for line in shown.splitlines()[1:] if not line.startswith("result")])


def test_python_of_the_tour_prints_what_the_tour_shows(tour: tuple[Path, str]) -> None:
    code, = code_blocks("README.md", "python")
    shown = next(block for block in code_blocks("README.md", "text") if block.startswith("u_y = "))
    printed = run([sys.executable, "-c", code], tour[0])
    words = re.compile(r"[-\d.]+")
    assert words.sub("#", printed) == words.sub("#", shown)
    # The last digits shown: another partition or library changes the field by far less.
    assert numbers(printed) == pytest.approx(numbers(shown), abs=2e-3)


@pytest.mark.parametrize("number", range(2))
def test_python_of_the_result_file_document_runs(tour: tuple[Path, str], number: int) -> None:
    code = code_blocks("docs/result-file.md", "python")[number]
    assert run([sys.executable, "-c", code], tour[0] / "tour")


def test_translation(tmp_path: Path) -> None:
    printed = run_example("translation", tmp_path / "out")
    # Rounding to whole grey levels alone leaves 2.4e-3 px on triangles of 16 px, less than half of that in the mean.
    assert numbers_after("mean displacement: ", printed) == pytest.approx([0.3, -0.2], abs=1.2e-3)
    rms, = numbers_after("RMS error against the known translation: ", printed)
    assert rms < 4e-3


def test_bending_beam(tmp_path: Path) -> None:
    printed = run_example("bending_beam", tmp_path / "out")
    rows = {wavelength: numbers_after(rf" +{wavelength} ", printed) for wavelength in (32, 128, 512)}
    # The field is in equilibrium: what remains is the noise that passes the filter, a fixed realisation of it
    # (measured 4.3e-4, 3.3e-5 and 4.9e-6 in the axial strain); twice that, and a steep fall, are asked for.
    for wavelength, bound in ((32, 1e-3), (128, 7e-5), (512, 1e-5)):
        assert max(rows[wavelength][:3]) < bound
    assert rows[32][0] > 5 * rows[128][0] > 5 * 3 * rows[512][0]
    # The exact curvature is 2e-5 per px; measured 0.33, 0.14 and 0.04 % from it.
    for wavelength, percent in ((32, 1.0), (128, 0.5), (512, 0.1)):
        assert rows[wavelength][3] == pytest.approx(2e-5, rel=percent / 100)
        assert rows[wavelength][4] < percent


def test_restart(tmp_path: Path) -> None:
    printed = run_example("restart", tmp_path / "out")
    first, _, *_ = numbers_after("frame_1: RMS error ", printed)
    second, iterations, *_ = numbers_after("frame_2: RMS error ", printed)
    assert "started from displacement" in printed
    # Noise of 1 grey level leaves 4e-3 px on elements of 32 px and 8e-3 px on elements of 16 px.
    assert first < 6e-3
    assert second < 1.2e-2
    # From zero the second frame, 8 px away, is not found in 50; from the first, 3 px away at most, in 5.
    assert iterations <= 7


def test_near_far(tmp_path: Path) -> None:
    printed = run_example("near_far", tmp_path / "out")
    off, *_ = numbers_after("calibration: ", printed)
    # Fine speckles that the far camera does not resolve are the calibration's noise: it says 0.3 near px itself.
    assert off < 1.0
    x, y, *spread, _, _ = numbers_after("alpha: ", printed)
    # Three of the standard deviations that the result states, for a fixed realisation of the noise.
    assert abs(x - 3.7) < 3 * spread[0]
    assert abs(y + 2.2) < 3 * spread[1]
    assert max(spread) < 0.005
    far, = numbers_after("far field: RMS error ", printed)
    near, = numbers_after("near field: RMS error ", printed)
    # Measured 8.7e-3 and 4.9e-3 px.
    assert far < 1.2e-2
    assert near < 0.8 * far
    assert (tmp_path / "out" / "result.near-far.png").stat().st_size > 10_000

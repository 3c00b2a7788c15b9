"""Every example, run as a user runs it, and its number."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from accept.support.follow_page import NUMBER, find_differences

pytestmark = pytest.mark.program

ROOT = Path(__file__).parents[1]

of_the_tour = pytest.mark.xdist_group("tour")
"""On one process, so that the demo is run once."""

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
    return [float(found) for found in NUMBER.findall(text)]


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


def run_script(name: str, folder: Path, *arguments: str, ranks: int = 0) -> list[float]:
    """Numbers that a single script prints, which must be those that its docstring shows at its end."""
    launcher = ["mpirun", "-n", str(ranks), sys.executable, "-m", "mpi4py"] if ranks else [sys.executable]
    script = ROOT / "examples" / f"{name}.py"
    printed = run([*launcher, str(script), *arguments], folder)
    shown = shown_in_docstring(script)
    assert find_differences(printed, shown) == []
    return numbers(printed)


def shown_in_docstring(script: Path) -> str:
    """The last indented lines of a script's docstring."""
    docstring = ast.get_docstring(ast.parse(script.read_text(encoding="utf-8")))
    assert docstring, script
    lines = docstring.split("\n\n")[-1].splitlines()
    assert all(line.startswith("    ") for line in lines), docstring
    return "".join(f"{line[4:]}\n" for line in lines)


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Folder in which the demo has left its files in tour/, as the README's tour does, and what it printed."""
    folder = tmp_path_factory.mktemp("demo")
    return folder, run_example("demo", folder / "tour")


@of_the_tour
def test_demo_error_is_the_noise_floor(tour: tuple[Path, str]) -> None:
    rms, _ = numbers_after("RMS error against the known field: ", tour[1])
    sigma, floor, ratio = numbers_after("noise floor, sigma = ", tour[1])
    assert sigma == 2.0
    # The noise and the images come from one seed, so only rounding moves these.
    assert 0.003 < floor < 0.008
    # What the mesh cannot follow of Kirsch's field, 0.0015 px, adds 4 % in squares; the floor's estimate has 1 %.
    assert ratio < 1.1
    assert rms == pytest.approx(ratio * floor, rel=0.01)


@of_the_tour
def test_demo_leaves_the_files_of_the_tour(tour: tuple[Path, str]) -> None:
    for name in ("result.vtkhdf", "result.json", "result.residual.vtkhdf"):
        assert (tour[0] / "tour" / name).is_file()
    for kind in ("partition", "deformed", "residual", "krylov"):
        assert (tour[0] / "tour" / "pictures" / f"result.{kind}.png").stat().st_size > 10_000


@of_the_tour
def test_check_prints_what_the_tour_shows(tour: tuple[Path, str]) -> None:
    shown = next(block for block in code_blocks("README.md", "text") if "ddic check" in block)
    printed = run(["ddic", "check", "tour/case.toml"], tour[0])
    # The result's line ends in a folder of its own.
    assert ([line for line in printed.splitlines() if not line.startswith("result")]
            == [line for line in shown.splitlines()[1:] if not line.startswith("result")])


@of_the_tour
def test_python_of_the_tour_prints_what_the_tour_shows(tour: tuple[Path, str]) -> None:
    code, *_ = code_blocks("README.md", "python")
    shown = next(block for block in code_blocks("README.md", "text") if block.startswith("u_y = "))
    printed = run([sys.executable, "-c", code], tour[0])
    words = re.compile(r"[-\d.]+")
    assert words.sub("#", printed) == words.sub("#", shown)
    # The last digits shown: another partition or library changes the field by far less.
    assert numbers(printed) == pytest.approx(numbers(shown), abs=2e-3)


@of_the_tour
@pytest.mark.parametrize("number", range(3))
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
    # From zero the second frame, 8 px away, is not found in 50; from the first, 3 px away at most, in 6.
    assert iterations <= 7


def test_series(tmp_path: Path) -> None:
    printed = run_example("series", tmp_path / "out")
    rows = [numbers(line) for line in printed.splitlines() if "RMS error" in line]
    assert [row[:2] for row in rows] == [[k, 0.5 * k] for k in range(1, 9)]
    for *_, strain, exact, error in rows:
        # Noise of 1 grey level leaves 0.0035 px in the mean; ends of the bar, which nothing holds, have more.
        assert error < 7e-3
        # A cut-off wavelength of 48 px takes 1 % from a neck of 60 px; the last digit shown is 1e-4.
        assert strain == pytest.approx(exact, rel=0.012, abs=1.5e-4)
    assert "    8     4  frame_8.tif" in printed
    read = (tmp_path / "out" / "strain.csv").read_text(encoding="utf-8").splitlines()
    assert len(read) == 1 + 2 * 8
    pictures = sorted(path.name for path in (tmp_path / "out" / "pictures").iterdir())
    assert pictures == ["series.curves.png", "series.frame_8.strain.png", "series.strain_xx.gif"]
    assert all((tmp_path / "out" / "pictures" / name).stat().st_size > 10_000 for name in pictures)


@pytest.mark.real_data
@pytest.mark.usefixtures("real_data")
def test_crack(tmp_path: Path) -> None:
    printed = run_example("crack", tmp_path / "out")
    figures = {frame: numbers_after(f"frame {frame}: open by ", printed) for frame in (60, 120)}
    # Iterated to 0.002 px RMS, 0.1 px anywhere: openings differ by 0.01 px from those of a looser tolerance.
    assert figures[60][:3] == pytest.approx([1.19, 0.20, 0.03], abs=0.02)
    assert figures[120][:3] == pytest.approx([3.12, 0.75, 0.22], abs=0.02)
    # Grey levels of 65535: three times less with the line where it is 3 px open.
    assert figures[120][-1] > 2.5 * figures[120][-2]
    assert figures[60][-1] > 1.25 * figures[60][-2]
    factors = [numbers(line) for line in printed.splitlines() if line.startswith("K_I / mu")]
    (at_60, scatter_60, *_), (at_120, scatter_120, *_) = ([row[0], *row[-2:]] for row in factors)
    # How far a factor scatters is what it is known to: a fifth at frame 120, nothing at frame 60.
    assert at_120 == pytest.approx(0.276, abs=0.05)
    assert 0.02 < scatter_120 < 0.1
    assert abs(at_60 - 0.068) < scatter_60
    assert scatter_60 > 0.5 * at_60
    assert "0.9 of the way to the left edge of the mesh" in printed


def test_opened_crack(tmp_path: Path) -> None:
    printed = run_example("opened_crack", tmp_path / "out")
    x, y, *_ = numbers_after("tip ", printed.split("left over")[1])
    # The cut-off wavelength rounds the root of r off, which moves the tip by a third of a pixel.
    assert x == pytest.approx(330.0, abs=0.5)
    assert y == 300.0
    factor, *_ = numbers_after(r"K_I / mu ", printed.split("left over")[1])
    # Noise of 2 grey levels leaves a tenth of a per cent; what the cut-off wavelength takes is two tenths.
    assert factor == pytest.approx(0.3, rel=0.005)
    largest, rms = numbers_after("opening up to ", printed)
    assert largest > 6
    # Elements about the tip hold no root of r: 0.03 px, and 0.01 px farther behind it.
    assert rms < 0.05
    for kind in ("deformed_y", "opening"):
        assert (tmp_path / "out" / f"case.{kind}.png").stat().st_size > 10_000


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
    assert (tmp_path / "out" / "result.near-far_y.png").stat().st_size > 10_000


def test_every_example_is_tested() -> None:
    folders = {path.parent.name for path in (ROOT / "examples").glob("*/run.sh")}
    scripts = {path.stem for path in (ROOT / "examples").glob("*.py")}
    tests = [name.removeprefix("test_") for name in globals() if name.startswith("test_")]
    untested = [name for name in folders | scripts if not any(test.startswith(name) for test in tests)]
    assert untested == []
    assert len(folders | scripts) >= 15


@pytest.mark.parametrize("script", sorted((ROOT / "examples").glob("*.py")), ids=lambda path: path.stem)
def test_example_fits_a_page(script: Path) -> None:
    assert len(script.read_text(encoding="utf-8").splitlines()) < 60
    # How to run it, and what it prints with its numbers.
    assert f"python examples/{script.name}" in script.read_text(encoding="utf-8").replace("-m mpi4py ", "")
    assert NUMBER.search(shown_in_docstring(script))


def test_sliding(tmp_path: Path) -> None:
    continuous, extended, slip, spread = run_script("sliding", tmp_path)
    # 8 bit leave a few thousandths on 32-px elements; the smeared slip of 0.45 px is ten times that.
    assert extended < 3e-3
    assert continuous > 10 * extended
    assert slip == pytest.approx(0.45, abs=0.01)
    assert spread < 0.01


def test_pixel_elements(tmp_path: Path) -> None:
    side, n_unknowns, n_corrections, error, size, complete = run_script("pixel_elements", tmp_path)
    assert (side, size) == (1, 16)
    assert n_unknowns == 2 * 300**2
    assert n_corrections <= 6
    # Noise of 2 grey levels on 16-px elements; a cut-off of 64 px averages over four times their side.
    assert error < 4e-3
    assert 2 * error < complete < 0.015


def test_measure_arrays(tmp_path: Path) -> None:
    strain_xx, strain_yy, rms, _ = run_script("measure_arrays", tmp_path)
    # Noise of the mean over 260 px and ten rows of nodes stays below 1e-4.
    assert strain_xx == pytest.approx(0.010, abs=1e-4)
    assert strain_yy == pytest.approx(-0.003, abs=1e-4)
    # One grey level and rounding leave 0.006 px on elements of 20 px.
    assert rms < 0.01


def test_own_mesh(tmp_path: Path) -> None:
    _, _, outwards = run_script("own_mesh", tmp_path)
    # 12 mm x 0.004; 0.001 mm are 0.01 px, the noise of the mean over the rim's 48 nodes is a fifth of that.
    assert outwards == pytest.approx(0.048, abs=1e-3)


def test_mask(tmp_path: Path) -> None:
    without, excluded, with_mask = run_script("mask", tmp_path)
    assert without > 0.5
    # What looks alike in both images, dark speckle and the wire's shade of grey, stays.
    assert excluded < 0.3
    # The largest of 308 values whose noise is 0.01 px, and more at the sides.
    assert with_mask < 0.15


def test_cut_off_wavelengths(tmp_path: Path) -> None:
    printed = run_script("cut_off_wavelengths", tmp_path)
    noise, left = printed[1::3], printed[2::3]
    assert noise == sorted(noise, reverse=True)
    # A wave of shear is halved at 0.87 l_c, and passes as 1 / (1 + (0.87 l_c / wavelength)^4): in a mesh of 36 elements
    # across, to a tenth.
    for l_c, of_wave in zip(printed[0::3], left, strict=True):
        assert of_wave == pytest.approx(1 / (1 + (0.87 * l_c / 100) ** 4), abs=0.1)


def test_frames(tmp_path: Path) -> None:
    printed = run_script("frames", tmp_path)
    strains = printed[1:10:2]
    # Noise of the mean over 210 px stays below 1e-4.
    assert strains == pytest.approx([0.002, 0.004, 0.006, 0.008, 0.010], abs=1e-4)
    n_subdomains, n_factorized = printed[-2:]
    assert n_subdomains == n_factorized


def test_points_and_meshio(tmp_path: Path) -> None:
    length, elongation, strain, n_points, *_, largest = run_script("points_and_meshio", tmp_path)
    assert length == 200.0
    # Two points with noise of 0.003 px each.
    assert elongation == pytest.approx(1.6, abs=0.012)
    assert strain == pytest.approx(0.008, abs=6e-5)
    assert n_points == 154
    # At the right and left side of the mesh: 0.008 x 130 along x, 0.45 along y.
    assert largest == pytest.approx((1.04**2 + 0.45**2) ** 0.5, abs=0.05)
    assert (tmp_path / "field.vtu").is_file()


def test_grey_correction(tmp_path: Path) -> None:
    printed = run_script("grey_correction", tmp_path)
    errors, residuals = printed[0:6:2], printed[1:6:2]
    assert errors == sorted(errors, reverse=True)
    assert residuals == sorted(residuals, reverse=True)
    # 1.4 grey levels of noise, and a shadow that is not constant in an element: 20 px of 0.001 a px, 100 grey levels.
    assert residuals[-1] < 2.5
    # "auto" takes the shadow's slope off as well.
    auto_error, auto_residual = printed[6:]
    assert auto_residual < 1.7
    # As in even light: 0.006 px, more for less contrast in g and three unknowns more for each element.
    assert auto_error <= 0.01


def test_methods_compared(tmp_path: Path) -> None:
    assert max(run_script("methods_compared", tmp_path)) < 1e-9


def test_mpirun_script(tmp_path: Path) -> None:
    *_, u_x, u_y = run_script("mpirun_script", tmp_path, ranks=2)
    # Interpolation's bias at these shifts, 1.4e-3 px, is more than the noise of the mean.
    assert (u_x, u_y) == pytest.approx((0.3, -0.2), abs=2e-3)


def test_strain_around_hole(tmp_path: Path) -> None:
    *_, beside, beside_exact, far, far_exact = run_script("strain_around_hole", tmp_path)
    # Elements of 14 px beside a hole of 50 px follow a steep gradient to a tenth.
    assert beside == pytest.approx(beside_exact, rel=0.1)
    assert 2 < beside_exact / 0.005 < 3
    assert far == pytest.approx(far_exact, rel=0.03)


def test_own_model(tmp_path: Path) -> None:
    nu, of_nu, _, strain, of_strain, _, _, chi = run_script("own_model", tmp_path)
    # Three standard deviations, and what elements of 14 px smooth of the model at the hole.
    assert abs(nu - 0.33) < 3 * of_nu + 0.003
    assert abs(strain - 0.005) < 3 * of_strain + 2e-5
    assert chi < 1.3


def test_read_result(tmp_path: Path) -> None:
    _, difference, _, correction, *_, residual, largest = run_script("read_result", tmp_path)
    assert difference == 0.0
    assert correction < 1e-3
    # Two images with noise of 1 grey level and rounding.
    assert residual == pytest.approx(1.47, abs=0.15)
    # 0.01 x 120 px x 0.05 mm at the right side.
    assert largest == pytest.approx(0.06, abs=2e-3)


def test_noise_floor(tmp_path: Path) -> None:
    printed = run_script("noise_floor", tmp_path)
    for measured, theory in zip(printed[1::4], printed[2::4], strict=True):
        # 81 inner nodes of two components give a standard deviation to 1/sqrt(2 x 162), 6 %; twice that.
        assert measured == pytest.approx(theory, rel=0.12)


def test_residual_image(tmp_path: Path) -> None:
    residual, x, y = run_script("residual_image", tmp_path)
    assert residual == pytest.approx(1.47, abs=0.15)
    # The drop lies at (192, 79) in the deformed image and has moved by (2.1, -0.9) px.
    assert (x, y) == (190, 80)


def test_given_start(tmp_path: Path) -> None:
    u, v, rms = run_script("given_start", tmp_path)
    assert (u, v) == pytest.approx((41.0, 0.0), abs=0.01)
    # Noise of 2 grey levels in both images on elements of 20 px, whose grey levels rise by 20 a pixel or so.
    assert rms < 0.02


def test_large_motion(tmp_path: Path) -> None:
    _, _, angle, rms = run_script("large_motion", tmp_path)
    # 0.006 px at 225 nodes, at 115 px from the middle on average.
    assert angle == pytest.approx(1.5, abs=2e-3)
    assert rms < 0.01


def test_volume(tmp_path: Path) -> None:
    zz, xz, rms, _, regularized = run_script("volume", tmp_path)
    # Noise moves each of 343 nodes by some hundredths of a voxel, and the mean strain of 48 voxels by a ten thousandth.
    assert zz == pytest.approx(0.010, abs=2e-4)
    assert xz == pytest.approx(0.002, abs=2e-4)
    assert rms < 0.03
    assert regularized < rms


@pytest.mark.parametrize(("method", "ranks"), [("dual", 2), ("assembled", 2), ("monolithic", 0)])
def test_integrated_dic(tmp_path: Path, method: str, ranks: int) -> None:
    _, _, error = run_script("integrated_dic", tmp_path, method, ranks=ranks)
    # The spline's bias, 1.4e-3 px, and what squares of 10 px cannot follow of the fourth power of x.
    assert error < 3e-3


@pytest.mark.parametrize(("method", "ranks"), [("dual", 0), ("conjugate_gradient", 2)])
def test_fixed_components(tmp_path: Path, method: str, ranks: int) -> None:
    n_nodes, n_unknowns, strain, held, others = run_script("fixed_components", tmp_path, method, ranks=ranks)
    assert n_unknowns == 2 * n_nodes - n_nodes / 3
    assert strain == pytest.approx(0.01, abs=1e-4)
    assert held == 0.0
    # Noise, as far as a field of elements of 15 px has it.
    assert others < 0.015

"""Where an image bears a pattern, and the case file that is written for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from ddic.case.loader import load_case
from ddic.check.pattern import BLOCK, choose_region, find_pattern
from ddic.cli.app import command_line
from ddic.images.binned import ArraySource
from ddic.io.image_file import open_image
from ddic.mesh.structured import build_grid_lines
from ddic.synth.speckle import SpeckleTexture

WIDTH, HEIGHT = 640, 480
SPECIMEN = (130, 40, 510, 470)
"""First column and row, and those past the last."""

HOLE = ((320.0, 250.0), 50.0)


def draw(size_factor: float = 1.0, seed: int = 3) -> np.ndarray:
    """A specimen with a hole before a dark background, with noise of 2 grey levels."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    x0, y0, x1, y1 = SPECIMEN
    shown = (x >= x0) & (x < x1) & (y >= y0) & (y < y1) & (np.hypot(x - HOLE[0][0], y - HOLE[0][1]) > HOLE[1])
    levels = np.where(shown, 255.0 * SpeckleTexture(seed, size_factor=size_factor).grey(x, y), 20.0)
    noise = 2.0 * np.random.default_rng(seed).standard_normal(levels.shape)
    return np.asarray(np.clip(np.rint(levels + noise), 0, 255), np.uint8)


def source(pixels: np.ndarray) -> ArraySource:
    return ArraySource(Path("memory"), pixels.astype(np.float32), 255.0)


def test_texture_is_found_where_the_specimen_is() -> None:
    pattern = find_pattern(source(draw()))
    x0, y0, x1, y1 = SPECIMEN
    points = np.array([[x0 + 40, y0 + 40], [x1 - 40, y1 - 40], [20, 20], [WIDTH - 10, 200], HOLE[0]], float)
    assert pattern.find_bare(points).tolist() == [False, False, True, True, True]
    # The reference pattern's features, FWHM of the autocorrelation (accept: 4.8 px).
    assert pattern.feature_size == pytest.approx(4.8, abs=0.4)
    assert pattern.choose_element_size() == 16
    assert pattern.describe_elements(16.0) == "features of 4.8 px, 3.3 along the side of an element"
    assert "16 px are suggested" in pattern.describe_elements(8.0)


@pytest.mark.parametrize("size_factor", [1.0, 2.0])
def test_the_region_lies_on_the_specimen_and_its_elements_grow_with_the_pattern(size_factor: float) -> None:
    image = source(draw(size_factor))
    pattern = find_pattern(image)
    element = pattern.choose_element_size()
    region = np.array(choose_region(pattern, image))
    assert element == pytest.approx(16 * size_factor, abs=2)
    # Inside the specimen, with the hole, and no more than two blocks and an element from its edges.
    inset = region - SPECIMEN
    assert (inset[:2] >= 0).all()
    assert (inset[2:] <= 0).all()
    assert np.abs(inset).max() <= 2 * BLOCK + element
    assert ((region[2:] - region[:2]) % element == 0).all()


def test_an_image_full_of_pattern_is_taken_whole_and_a_bare_one_does_not_fail() -> None:
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    full = source(np.rint(255.0 * SpeckleTexture(3).grey(x, y)))
    x0, y0, x1, y1 = choose_region(find_pattern(full), full)
    assert (x1 - x0) * (y1 - y0) >= 0.85 * WIDTH * HEIGHT
    bare = source(np.full((HEIGHT, WIDTH), 20.0))
    pattern = find_pattern(bare)
    assert np.isnan(pattern.feature_size)
    assert "is there a pattern" in pattern.describe_elements(16.0)
    x0, y0, x1, y1 = choose_region(pattern, bare)
    assert 0 <= x0 < x1 <= WIDTH
    assert 0 <= y0 < y1 <= HEIGHT


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    pixels = draw()
    tifffile.imwrite(tmp_path / "f.tif", pixels)
    tifffile.imwrite(tmp_path / "g 1.tif", np.roll(pixels, 2, axis=1))
    tifffile.imwrite(tmp_path / "g 2.tif", np.roll(pixels, 4, axis=1))
    return tmp_path


def test_what_is_written_is_a_case_that_names_the_images_from_its_folder(pair: Path) -> None:
    case = pair / "case.toml"
    outcome = CliRunner().invoke(command_line, ["new", str(pair / "f.tif"), str(pair / "g 1.tif"),
                                                "--output", str(case)])
    assert outcome.exit_code == 0, outcome.output
    assert 'deformed = "g 1.tif"' in case.read_text()
    loaded = load_case(case).case
    assert loaded.images.deformed == pair / "g 1.tif"
    assert loaded.mesh.structured is not None
    assert loaded.mesh.structured.element_size == 16
    # What is told as a comment is a case too.
    section = case.read_text().replace("# [reg", "[reg").replace("# cut", "cut").replace("# not_c", "not_c")
    case.write_text(section.replace("# uncertainty", "uncertainty").replace("# circles", "circles"))
    assert load_case(case).case.regularization is not None


def test_several_deformed_images_are_a_series(pair: Path) -> None:
    case = pair / "case.toml"
    outcome = CliRunner().invoke(command_line, ["new", *(str(pair / name) for name in ("f.tif", "g 1.tif", "g 2.tif")),
                                                "--output", str(case)])
    assert outcome.exit_code == 0, outcome.output
    assert load_case(case).case.images.deformed == (pair / "g 1.tif", pair / "g 2.tif")


@pytest.mark.parametrize(("words", "message"), [
    (["gone.tif", "g 1.tif"], "no such"), (["f.tif", "small.tif"], "one size"), (["f.tif"], "Missing argument"),
    (["f.tif", "g 1.tif", "--output", "there.toml"], "is there already"),
    (["f.tif", "g 1.tif", "--output", "case.txt"], "ends in .toml"),
    (["f.tif", "g 1.tif", "--output", "gone/case.toml"], "does not exist")])
def test_what_cannot_be_written_is_said_in_a_line(pair: Path, monkeypatch: pytest.MonkeyPatch, words: list[str],
                                                  message: str) -> None:
    monkeypatch.chdir(pair)
    tifffile.imwrite(pair / "small.tif", np.zeros((20, 20), np.uint8))
    (pair / "there.toml").write_text("# mine\n")
    outcome = CliRunner().invoke(command_line, ["new", *words])
    assert outcome.exit_code == 2
    assert message in outcome.stderr
    assert len(outcome.stderr.splitlines()) == 1
    assert (pair / "there.toml").read_text() == "# mine\n"
    assert not (pair / "case.toml").exists()


def check(folder: Path, region: str, deformed: str = '"g 1.tif"', *words: str) -> tuple[int, dict[str, str], str]:
    """Exit code, lines and warnings of ddic check."""
    (folder / "case.toml").write_text(f'[images]\nreference = "f.tif"\ndeformed = {deformed}\n[mesh.structured]\n'
                                      f"region = {region}\nelement_size = 16\n")
    outcome = CliRunner().invoke(command_line, ["check", str(folder / "case.toml"), *words])
    lines = dict(line.split(maxsplit=1) if line[:5] != "frame" else (line[:7], line[7:].strip())
                 for line in outcome.stdout.splitlines())
    return outcome.exit_code, lines, outcome.stderr


def test_check_tells_what_the_pattern_asks_and_which_cells_are_bare(pair: Path) -> None:
    code, lines, _ = check(pair, "[144, 64, 496, 448]")
    assert code == 0
    assert lines["pattern"].startswith("features of 4.")
    # Inside the hole: 7,854 px, of blocks and cells of 256 those that are not on its edge.
    n_bare = int(lines["bare"].split()[1])
    assert 10 <= n_bare <= 30
    assert lines["verdict"] == "ready to run"
    # The cells of the whole grid at once.
    pattern = find_pattern(open_image(pair / "f.tif"))
    centres = build_grid_lines((144.0, 64.0, 496.0, 448.0), 16.0).centroids
    assert n_bare == pattern.find_bare(centres).sum()
    # Rows in the place of columns.
    _, swapped, _ = check(pair, "[0, 144, 128, 464]")
    assert "is bare" in swapped["verdict"]


def test_check_lists_the_frames_of_a_series_and_warns_of_the_reference_among_them(pair: Path) -> None:
    _, lines, warned = check(pair, "[144, 64, 496, 448]", '["g 1.tif", "f.tif"]')
    assert lines["frame 1"] == "g 1.tif, time 1"
    assert lines["frame 2"] == "f.tif, time 2"
    assert "frame 2 is the reference image itself" in warned


def test_check_draws_the_mesh_of_a_case_that_is_refused(pair: Path) -> None:
    code, _, said = check(pair, "[144, 64, 1000, 448]", '"g 1.tif"', "--plot", str(pair / "mesh.png"))
    assert code == 2
    assert "lies outside the image" in said
    assert (pair / "mesh.png").stat().st_size > 10_000

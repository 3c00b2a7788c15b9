"""``ddic calibrate``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner, Result

from ddic.cli.calibrate import calibrate_near
from ddic.io.mapping_file import read_mapping_file
from support.commands import ddic
from support.two_cameras import BARREL, TURNED, UPRIGHT, corners_and_centre, far_grey, near_grey


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    tifffile.imwrite(tmp_path / "far.tif", far_grey(TURNED).astype(np.float32))
    tifffile.imwrite(tmp_path / "near.tif", near_grey().astype(np.float32))
    return tmp_path


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(calibrate_near, list(map(str, arguments)))


def test_prints_what_it_found_and_writes_it(folder: Path) -> None:
    mapping = folder / "mapping.toml"
    outcome = run(folder / "far.tif", folder / "near.tif", "--ratio", "4", "--output", mapping)
    assert outcome.exit_code == 0, outcome.output
    names = [line[:20].strip() for line in outcome.stdout.splitlines()]
    assert names == ["ratio", "rotation", "offset", "not a similarity", "near top left", "near top right",
                     "near bottom left", "near bottom right", "near centre", "grey levels", "correlation", "residual",
                     "mapping file"]
    ratio, rotation = (float(line[20:].split()[0]) for line in outcome.stdout.splitlines()[:2])
    assert ratio == pytest.approx(4.2, abs=1e-4)
    assert rotation == pytest.approx(-3.0, abs=1e-3)
    written = read_mapping_file(mapping)
    X = TURNED.to_specimen(corners_and_centre())
    np.testing.assert_allclose(written.mapping.to_image(X), corners_and_centre(), atol=2e-3)
    assert (written.far_size, written.near_size) == ((130, 110), (280, 240))
    assert written.coefficient is not None
    assert written.coefficient > 0.9999
    assert 0 < written.position_std < 0.01


def test_distortion_is_printed(folder: Path) -> None:
    tifffile.imwrite(folder / "far.tif", far_grey(BARREL).astype(np.float32))
    outcome = run(folder / "far.tif", folder / "near.tif", "--ratio", "4", "--distortion")
    assert outcome.exit_code == 0, outcome.output
    assert "distortion k1" in outcome.stdout


def test_a_translation_keeps_the_ratio(folder: Path) -> None:
    tifffile.imwrite(folder / "far.tif", far_grey(UPRIGHT).astype(np.float32))
    outcome = run(folder / "far.tif", folder / "near.tif", "--ratio", "4", "--model", "translation")
    assert outcome.exit_code == 0, outcome.output
    assert "ratio               4.000000 +- 0.000000" in outcome.stdout


def assert_one_line(outcome: Result, *words: str) -> None:
    assert outcome.exit_code == 2
    assert outcome.stdout == ""
    lines = outcome.stderr.splitlines()
    assert len(lines) == 1, lines
    assert all(word in lines[0] for word in words), lines


def test_wrong_inputs_end_with_one_line(folder: Path) -> None:
    far, near = folder / "far.tif", folder / "near.tif"
    (folder / "text.tif").write_text("no image")
    hole = far_grey(TURNED).astype(np.float32)
    hole[3, 5] = np.nan
    tifffile.imwrite(folder / "nan.tif", hole)
    assert_one_line(run(far, near, "--ratio", "8"), "--ratio 8: is off by more than 15 %", "give --ratio 4.2")
    assert_one_line(run(far, folder / "none.tif", "--ratio", "4"), "none.tif: no such image file")
    assert_one_line(run(folder / "text.tif", near, "--ratio", "4"), "text.tif")
    assert_one_line(run(folder / "nan.tif", near, "--ratio", "4"), "nan.tif", "NaN")
    assert_one_line(run(far, near, "--ratio", "4", "--output", folder / "no" / "m.toml"), "does not exist")


def test_the_program_has_the_command(folder: Path) -> None:
    finished = ddic("calibrate", folder / "far.tif", folder / "none.tif", "--ratio", "4")
    assert finished.code == 2
    assert len(finished.errors) == 1

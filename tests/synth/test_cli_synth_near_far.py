import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from ddic.cli.app import command_line
from ddic.synth.fields import Kirsch
from ddic.synth.near_far_scene import SetUpMotion, build_near_mapping
from ddic.synth.render import Picture
from ddic.synth.speckle import two_scale_texture
from ddic.synth.truth import load_near_far_truth

SMALL = ("--size-far", "140x110", "--size-near", "160x120")
FILES = ["far_reference.tif", "far_deformed.tif", "near_reference.tif", "near_deformed.tif", "truth.json"]


def run(*arguments):
    return CliRunner().invoke(command_line, ["synth", "near-far", *(str(argument) for argument in arguments)])


def test_the_default_set_up(tmp_path):
    result = run(*SMALL, "--output", tmp_path / "new")
    assert result.exit_code == 0, result.output
    assert result.output.split() == [str(tmp_path / "new" / name) for name in FILES]
    truth = load_near_far_truth(tmp_path / "new" / "truth.json")
    assert truth.field == Kirsch((69.5, 54.5), 11.0, 0.005)
    # The hole's edge at 80.5, a quarter of the near field's 160 / 5 far px left of its centre.
    assert truth.motion == SetUpMotion((3.7, -2.2), 0.0, (88.5, 54.5))
    np.testing.assert_allclose(truth.mapping.homography, [[5, 0, 79.5 - 442.5], [0, 5, 59.5 - 272.5], [0, 0, 1]])


def test_every_option_reaches_the_images(tmp_path):
    result = run(*SMALL, "--ratio", 4, "--alpha", 1, 0.5, "--rotation", 2, "--near-center", 90, 50, "--near-angle", 3,
                 "--tilt", 0.01, 0.02, "--center", 60, 50, "--radius", 9, "--strain", 0.01, "--poisson-ratio", 0.2,
                 "--translation", 0.3, 0.4, "--bit-depth", 16, "--seed", 8, "--speckle-size", 2, "--fine-share", 0.3,
                 "--output", tmp_path)
    assert result.exit_code == 0, result.output
    truth = load_near_far_truth(tmp_path / "truth.json")
    assert truth.field == Kirsch((60.0, 50.0), 9.0, 0.01, 0.2, (0.3, 0.4))
    assert truth.motion == SetUpMotion((1.0, 0.5), 2.0, (90.0, 50.0))
    near = build_near_mapping(4.0, (90.0, 50.0), Picture(160, 120), 3.0, (0.01, 0.02))
    np.testing.assert_array_equal(truth.mapping.homography, near.homography)
    texture = json.loads((tmp_path / "truth.json").read_text())["near"]["texture"]
    assert texture == dataclasses.asdict(two_scale_texture(4.0, 8, 2.0, 0.3))
    for name, size in zip(FILES[:4], 2 * [(110, 140)] + 2 * [(120, 160)], strict=True):
        image = tifffile.imread(tmp_path / name)
        assert image.shape == size
        assert image.dtype == np.uint16


@pytest.mark.parametrize(("options", "levels"), [
    (("--noise", 3), (3, 3)), (("--noise", 3, "--noise-near", 0), (3, 0)), (("--noise-far", 1), (1, 0))])
def test_each_camera_has_its_noise(tmp_path, options, levels):
    assert run(*SMALL, "--bit-depth", 32, "--output", tmp_path).exit_code == 0
    clean = [tifffile.imread(tmp_path / name).astype(float) for name in FILES[:4]]
    assert run(*SMALL, "--bit-depth", 32, *options, "--output", tmp_path).exit_code == 0
    for name, image, level in zip(FILES[:4], clean, np.repeat(levels, 2), strict=True):
        deviation = (tifffile.imread(tmp_path / name) - image).std()
        # 15400 pixels: five sampling deviations are 3 %.
        assert deviation == pytest.approx(level, rel=0.03)


@pytest.mark.parametrize(("arguments", "message"), [
    (("--ratio", 1), "ratio"), (("--ratio", "nan"), "ratio"), (("--ratio", 0), "ratio"),
    (("--ratio", 1.1), "outside the far image"), (("--near-center", 10, 50), "outside the far image"),
    (("--alpha", "nan", 0), "alpha"), (("--rotation", "inf"), "rotation"), (("--tilt", 3, 0), "horizon"),
    (("--size-near", "160"), "WIDTHxHEIGHT"), (("--noise-near", -1), "noise"), (("--noise-far", -1), "noise"),
    (("--radius", -3), "radius"), (("--seed", -1), "seed"), (("--speckle-size", 0), "size_factor"),
    (("--fine-share", 2), "fine_share"), (("--strain", 0.9), "folds"), (("--ratios", 3), "--ratio")])
def test_bad_input_is_one_line_and_exit_2(tmp_path, arguments, message):
    result = run(*SMALL, *arguments, "--output", tmp_path)
    assert result.exit_code == 2
    lines = result.output.strip().splitlines()
    assert len(lines) == 1
    assert message in lines[0]
    assert list(tmp_path.iterdir()) == []


def test_importing_the_command_loads_no_heavy_library():
    code = ("import sys, ddic.cli.synth; "
            "sys.exit(bool({'numpy', 'numba', 'tifffile', 'ddic.synth.near_far_scene'} & set(sys.modules)))")
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

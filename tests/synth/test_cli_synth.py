import subprocess
import sys

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from ddic.cli.app import command_line
from ddic.synth.fields import Affine, Bending, Hole, Kirsch, Sinusoidal, Sum, Translation
from ddic.synth.render import Digitiser, Picture, Scene, render_pair
from ddic.synth.speckle import SpeckleTexture
from ddic.synth.truth import load_truth


def run(*arguments):
    return CliRunner().invoke(command_line, ["synth", *(str(argument) for argument in arguments)])


@pytest.mark.parametrize(("arguments", "field"), [
    (("translation", "--vector", -1, 0.5), Translation((-1.0, 0.5))),
    (("affine", "--gradient", 0.1, 0.2, -0.1, 0.05, "--vector", 1, 2),
     Affine(((0.1, 0.2), (-0.1, 0.05)), (1.0, 2.0), (44.5, 29.5))),
    (("sinusoidal",), Sinusoidal()),
    (("sinusoidal", "--amplitude", 0.2, 0.3, "--wavelength-x", 80, 90, "--phase-y", 1, -2),
     Sinusoidal(amplitude=(0.2, 0.3), wavelength_x=(80.0, 90.0), phase_y=(1.0, -2.0))),
    (("kirsch", "--strain", 0.01, "--radius", 12), Kirsch((44.5, 29.5), 12.0, 0.01)),
    (("kirsch", "--center", 40, 20), Kirsch((40.0, 20.0), 6.0, 0.005)),
    (("bending", "--curvature", 1e-4, "--translation", 1, 0),
     Sum((Bending(1e-4, (44.5, 29.5)), Translation((1.0, 0.0))))),
])
def test_the_truth_is_the_field_asked_for(tmp_path, arguments, field):
    result = run(*arguments, "--size", "90x60", "--output", tmp_path / "new" / "pair")
    assert result.exit_code == 0, result.output
    assert load_truth(tmp_path / "new" / "pair" / "truth.json") == field


@pytest.mark.parametrize("bit_depth", [8, 16, 32])
def test_the_files_are_the_pair_asked_for(tmp_path, bit_depth):
    result = run("kirsch", "--size", "90x60", "--bit-depth", bit_depth, "--noise", 2, "--seed", 5,
                 "--speckle-size", 1.2, "--strain", 0.01, "--output", tmp_path)
    assert result.exit_code == 0, result.output
    field = load_truth(tmp_path / "truth.json")
    scene = Scene(SpeckleTexture(5, 1.2), field, Hole(field.center, field.radius))
    pair = render_pair(scene, Picture(90, 60, Digitiser(bit_depth, noise=2.0, seed=5)))
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "reference.tif"), pair.reference)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "deformed.tif"), pair.deformed)


def test_the_hole_can_be_left_unpainted(tmp_path):
    assert run("kirsch", "--size", "90x60", "--no-paint-hole", "--output", tmp_path).exit_code == 0
    pair = render_pair(Scene(SpeckleTexture(), load_truth(tmp_path / "truth.json")), Picture(90, 60))
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "reference.tif"), pair.reference)


@pytest.mark.parametrize(("arguments", "message"), [
    (("translation", "--size", "90"), "WIDTHxHEIGHT"),
    (("translation", "--size", "0x10"), "WIDTHxHEIGHT"),
    (("translation", "--vector", "nan", 0), "vector"),
    (("translation", "--vector", 1e308, 1e308), "a point lies more than 1e+09 px away"),
    (("translation", "--noise", -1), "noise"),
    (("translation", "--seed", -1), "seed"),
    (("translation", "--speckle-size", 0), "size_factor"),
    (("translation", "--bit-depth", 12), "--bit-depth"),
    (("kirsch", "--radius", -3), "radius"),
    (("kirsch", "--radious", 3), "--radius"),
    (("sinusoidal", "--amplitude", 400, 0), "folds"),
    (("rotation",), "rotation"),
])
def test_bad_input_is_one_line_and_exit_2(tmp_path, arguments, message):
    result = run(*arguments, "--output", tmp_path)
    assert result.exit_code == 2
    lines = result.output.strip().splitlines()
    assert len(lines) == 1
    assert message in lines[0]
    assert list(tmp_path.iterdir()) == []


def test_an_output_that_is_no_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    result = run("translation", "--output", tmp_path / "file" / "pair")
    assert result.exit_code == 2
    assert str(tmp_path / "file" / "pair") in result.output


def test_an_earlier_pair_is_replaced_whole_or_not_at_all(tmp_path):
    assert run("translation", "--size", "30x30", "--output", tmp_path).exit_code == 0
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert run("sinusoidal", "--amplitude", 400, 0, "--output", tmp_path).exit_code == 2
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert run("translation", "--size", "30x30", "--seed", 1, "--output", tmp_path).exit_code == 0
    after = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert set(after) == set(before)
    assert all(after[name] != content for name, content in before.items())


@pytest.mark.parametrize("folder", [".", "images"])
def test_images_of_a_case_are_not_replaced(tmp_path, folder):
    images = tmp_path / folder
    assert run("translation", "--size", "30x30", "--output", images).exit_code == 0
    before = {path.name: path.read_bytes() for path in images.iterdir()}
    text = f'[images]\nreference = "{folder}/reference.tif"\ndeformed = "{folder}/d*.tif"\n'
    (tmp_path / "case.toml").write_text(text)
    refused = run("translation", "--size", "30x30", "--seed", 1, "--output", images)
    assert refused.exit_code == 2
    assert "an input of" in refused.output
    assert len(refused.output.strip().splitlines()) == 1
    assert {name: (images / name).read_bytes() for name in before} == before


@pytest.mark.parametrize("name", ["reference.tif", "deformed.tif", "truth.json"])
@pytest.mark.parametrize("link", ["file", "hard", "symbolic"])
def test_files_that_are_there_stay(tmp_path, name, link):
    folder, kept = tmp_path / "pair", tmp_path / "kept"
    folder.mkdir()
    kept.write_text("mine")
    {"file": lambda at: at.write_text("mine"), "hard": lambda at: at.hardlink_to(kept),
     "symbolic": lambda at: at.symlink_to(kept)}[link](folder / name)
    refused = run("translation", "--size", "30x30", "--output", folder)
    assert refused.exit_code == 2
    assert str(folder / name) in refused.output
    assert [path.name for path in folder.iterdir()] == [name]
    assert (folder / name).read_text() == "mine"


def test_importing_the_command_loads_no_heavy_library():
    code = ("import sys, ddic.cli.synth; "
            "sys.exit(bool({'numpy', 'numba', 'tifffile', 'ddic.synth.render'} & set(sys.modules)))")
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

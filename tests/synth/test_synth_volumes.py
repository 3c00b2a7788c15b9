"""Pairs of volumes: in memory, in files, from the command line and from Python."""

import os

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

import ddic
from ddic.cli.app import command_line
from ddic.errors import InputError
from ddic.synth import speckle_kernels as kernels
from ddic.synth.fields import Affine, Kirsch, Sinusoidal, Sum, Translation
from ddic.synth.render import Digitiser, Picture, Scene, _create_tiff, render_pair, write_pair
from ddic.synth.speckle import SpeckleTexture, compute_moments
from ddic.synth.truth import load_truth

TEXTURE = SpeckleTexture(seed=9)
WAVES = Sinusoidal((0.35, -0.25, 0.15), (0.6, 0.5, 0.55), (60.0, 90.0, 80.0), (90.0, 60.0, 70.0), (0.3, -0.2, 0.1),
                   (-0.7, 0.5, -0.4), (80.0, 70.0, 60.0), (0.2, -0.3, 0.6))
# 15 % along x and a turn by 20 degrees about z: what a start must find by itself.
LARGE = Affine(((0.081, -0.342, 0.0), (0.393, -0.06, 0.0), (0.0, 0.0, 0.02)), (1.0, -0.4, 0.3), (20.0, 18.0, 17.0))
FIELDS = pytest.mark.parametrize("field", [WAVES, LARGE, Sum((WAVES, Translation((3.1, 0.0, -2.2))))],
                                 ids=lambda field: type(field).__name__)
# More than one cube of 32 voxels each way, and not a multiple of it.
SIZES = (40, 36, 35)


def picture(**digitiser):
    width, height, depth = SIZES
    return Picture(width, height, Digitiser(**digitiser), depth)


@pytest.fixture(scope="module")
def speckles():
    """All that may reach the points of these tests: the cells from -32 to 76 px."""
    cells = kernels.CellBlock((-8,) * 3, (27,) * 3)
    return kernels.draw_speckles(np.uint64(9), cells, kernels.count_speckles(np.uint64(9), cells))


def sum_directly(points, speckles):
    """Grey level at points (n, 3): every speckle at every point, nothing cut."""
    squares = ((points[:, None] - speckles[:, :3]) ** 2).sum(axis=2)
    mean, deviation = compute_moments(3)
    total = (speckles[:, 3] * np.exp(-squares * speckles[:, 4])).sum(axis=1)
    return 0.5 - 0.45 * np.tanh((total - mean) * 0.6 / deviation)


@FIELDS
def test_grey_levels_are_conserved_off_the_grid(field, speckles):
    points = np.random.default_rng(0).uniform(0, 35, (300, 3))
    moved = points + field.displacement(points)
    expected = sum_directly(points, speckles)
    scene = Scene(TEXTURE, field)
    # 0.45 of the tails that are cut, below 3e-7; of f and g the same ones, but for slopes of 0.5 times 1e-12 px.
    np.testing.assert_allclose(scene.reference_grey(points), expected, rtol=0, atol=1.4e-7)
    np.testing.assert_allclose(scene.deformed_grey(moved), scene.reference_grey(points), rtol=0, atol=3e-12)


@FIELDS
def test_the_volumes_are_the_scene_at_the_centres_of_voxels(field, speckles):
    pair = render_pair(Scene(TEXTURE, field), picture(bit_depth=32))
    assert pair.reference.shape == pair.deformed.shape == SIZES[::-1]
    rng = np.random.default_rng(1)
    voxels = np.vstack([[[31, 32, 31], [32, 31, 32], [39, 35, 34], [0, 0, 0]], rng.integers(0, SIZES, (150, 3))])
    where = tuple(voxels.T[::-1])
    # Rounding to float32 at 255, 8e-6, and the tails, 255 times 1.4e-7.
    np.testing.assert_allclose(pair.reference[where], 255 * sum_directly(voxels, speckles), rtol=0, atol=5e-5)
    # The point that came to a voxel, by an iteration that is not Newton's.
    origins = voxels.astype(float)
    for _ in range(400):
        origins = 0.5 * origins + 0.5 * (voxels - field.displacement(origins))
    np.testing.assert_allclose(origins + field.displacement(origins), voxels, rtol=0, atol=1e-12)
    np.testing.assert_allclose(pair.deformed[where], 255 * sum_directly(origins, speckles), rtol=0, atol=5e-5)


def test_cubes_are_the_whole():
    pair = render_pair(Scene(TEXTURE, WAVES), picture(bit_depth=32))
    z, y, x = np.indices(SIZES[::-1])
    np.testing.assert_array_equal(pair.reference, (255 * TEXTURE.grey(x, y, z)).astype(np.float32))
    whole = Scene(TEXTURE, WAVES).deformed_grey(np.column_stack([x.ravel(), y.ravel(), z.ravel()]).astype(float))
    # Inversions stop where all points of a cube have 1e-12 px: next float32 at most.
    np.testing.assert_allclose(pair.deformed, 255 * whole.reshape(x.shape), rtol=2e-7)


@pytest.mark.parametrize("bit_depth", [8, 16, 32])
def test_files_are_stacks_that_can_be_mapped(tmp_path, bit_depth):
    paths = tmp_path / "f.tif", tmp_path / "g.tif"
    scene, of_files = Scene(TEXTURE, WAVES), picture(bit_depth=bit_depth, noise=1.5, seed=3)
    write_pair(paths, scene, of_files)
    pair = render_pair(scene, of_files)
    for path, volume in zip(paths, (pair.reference, pair.deformed), strict=True):
        mapped = tifffile.memmap(path, mode="r")
        assert mapped.dtype == volume.dtype
        np.testing.assert_array_equal(mapped, volume)
        np.testing.assert_array_equal(tifffile.imread(path), volume)


def test_files_beyond_four_gigabytes(tmp_path):
    # 1700^3 voxels of 8 bit are 4.9 GB: a hole in the file but for its last pages.
    path = tmp_path / "large.tif"
    file = _create_tiff(path, Picture(1700, 1700, depth=1700))
    file.fill(1698, np.full((2, 1700, 1700), 7, dtype=np.uint8))
    mapped = tifffile.memmap(path, mode="r")
    assert mapped.shape == (1700, 1700, 1700)
    np.testing.assert_array_equal(mapped[1696:, 1699, 1699], [0, 0, 7, 7])
    assert os.stat(path).st_blocks * 512 < 50e6


def test_noise_is_independent_in_all_cubes_and_both_volumes():
    clean = render_pair(Scene(TEXTURE, Translation((0.0,) * 3)), picture(bit_depth=32)).reference
    pair = render_pair(Scene(TEXTURE, Translation((0.0,) * 3)), picture(bit_depth=32, noise=2.0, seed=4))
    noise = [(volume - clean).astype(float) for volume in (pair.reference, pair.deformed)]
    n = clean.size
    for sample in noise:
        # Five sampling deviations; grey levels from 12 to 216 are clipped nowhere.
        assert abs(sample.mean()) < 5 * 2 / np.sqrt(n)
        assert sample.std() == pytest.approx(2.0, abs=5 * 2 / np.sqrt(2 * n))
        assert abs(np.corrcoef(sample[:3, :32, :32].ravel(), sample[32:, :32, :32].ravel())[0, 1]) < 5 / np.sqrt(3072)
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 5 / np.sqrt(n)


def run(*arguments):
    return CliRunner().invoke(command_line, ["synth", *map(str, arguments)])


@pytest.mark.parametrize(("arguments", "field"), [
    (("translation",), Translation((0.25, -0.4, 0.3))),
    (("translation", "--vector", 1, 2, -0.5), Translation((1.0, 2.0, -0.5))),
    (("affine", "--gradient", 0.1, 0.2, 0, 0.3, -0.1, 0, 0, 0.05, -0.2, "--vector", 1, 2, 3, "--noise", 1),
     Affine(((0.1, 0.2, 0.0), (0.3, -0.1, 0.0), (0.0, 0.05, -0.2)), (1.0, 2.0, 3.0), (9.5, 8.5, 7.5))),
    (("affine", "--gradient", *[0] * 9, "--center", 1, 2, 3), Affine(((0.0,) * 3,) * 3, (0.0,) * 3, (1.0, 2.0, 3.0))),
    (("sinusoidal", "--wavelength-z", 90, 80, 70),
     Sinusoidal((0.35, -0.25, 0.15), (0.6, 0.5, 0.55), (1024.0, 1280.0, 1150.0), (1280.0, 1024.0, 1100.0),
                (0.3, -0.2, 0.1), (-0.7, 0.5, -0.4), (90.0, 80.0, 70.0), (0.2, -0.3, 0.6))),
])
@pytest.mark.parametrize("size", [("--size", "20x18x16"), ("--size=20x18x16",), ("--size=9x9", "--size", "20X18X16")])
def test_three_sizes_ask_for_volumes(tmp_path, arguments, field, size):
    result = run(*arguments, *size, "--output", tmp_path)
    assert result.exit_code == 0, result.output
    assert load_truth(tmp_path / "truth.json") == field
    assert tifffile.imread(tmp_path / "deformed.tif").shape == (16, 18, 20)


@pytest.mark.parametrize(("arguments", "message"), [
    (("kirsch", "--size", "20x18x16"), "20x18x16 is a volume, and kirsch plane: give WIDTHxHEIGHT"),
    (("bending", "--size", "20x18x16"), "bending plane"),
    (("near-far", "--size-near", "20x18x16"), "near-far plane"),
    (("translation", "--size", "20x18x16x3"), "is not WIDTHxHEIGHT"),
    (("translation", "--size", "20x18x0"), "is not WIDTHxHEIGHT"),
    (("translation", "--vector", 1, 2, 3), "unexpected extra argument"),
    (("translation", "--vector", 1, 2, "--size", "20x18x16"), "--vector"),
    (("translation", "--vector", "nan", 0, 0, "--size", "20x18x16"), "--vector"),
    (("sinusoidal", "--phase-z", 1, 2, 3), "must have a number for each axis, two in all or three in all"),
    (("affine", "--gradient", -2, *[0] * 8, "--size", "20x18x16"), "folds"),
])
def test_bad_input_is_one_line_and_exit_2(tmp_path, arguments, message):
    result = run(*arguments, "--output", tmp_path)
    assert result.exit_code == 2
    assert len(result.output.strip().splitlines()) == 1
    assert message in result.output
    assert list(tmp_path.iterdir()) == []


def test_help_tells_of_volumes_and_shows_what_they_have_by_default():
    assert "with --size WIDTHxHEIGHTxDEPTH" in " ".join(run("--help").output.split())
    plane, volume = (" ".join(run("sinusoidal", *size, "--help").output.split()) for size in ((), ("--size", "8x8x8")))
    assert "--size 64x64x64 --help shows them" in plane
    assert "0.35, -0.25]" in plane
    assert "0.35, -0.25, 0.15]" in volume


def test_a_pair_from_python():
    reference, deformed = ddic.make_synthetic_pair(LARGE.displacement, SIZES, noise=0, seed=9)
    pair = render_pair(Scene(TEXTURE, LARGE), picture())
    np.testing.assert_array_equal(reference, pair.reference)
    np.testing.assert_array_equal(deformed, pair.deformed)


@pytest.mark.parametrize(("displacement", "size", "options", "message"), [
    (np.zeros_like, (8, 8, 8, 8), {}, r"expected \(width, height\) or \(width, height, depth\)"),
    (np.zeros_like, (8, 8, 0), {}, "size = 8x8x0: must be at least 1x1x1 pixels"),
    (np.zeros_like, (8, 8, 8), {"hole": {"center": (4, 4), "radius": 2}}, "hole: a volume"),
    (lambda points: points[:, :2], (8, 8, 8), {}, r"returned an array of shape \(512, 2\)"),
    (3, (8, 8, 8), {}, r"a function of points \(n, 3\)"),
    (Kirsch(), (8, 8, 8), {}, "Kirsch has other axes than size"),
    (Sinusoidal(), (8, 8, 8), {}, "Sinusoidal has other axes than size"),
    (Translation((1.0, 2.0, 3.0)), (8, 8), {}, "give a field of 2 components")])
def test_what_is_no_pair_is_refused(displacement, size, options, message):
    with pytest.raises(InputError, match=message):
        ddic.make_synthetic_pair(displacement, size, **options)

import hashlib
import math

import numpy as np
import pytest
import tifffile

from ddic.errors import InputError
from ddic.synth.fields import Affine, Bending, Hole, Kirsch, Sinusoidal, Translation
from ddic.synth.render import Digitiser, Picture, Scene, render_pair, write_pair
from ddic.synth.speckle import SpeckleTexture

TEXTURE = SpeckleTexture(seed=9)


def render(field, width, height, hole=None, **digitiser):
    return render_pair(Scene(TEXTURE, field, hole), Picture(width, height, Digitiser(**digitiser)))


STILL = Translation()
SIZE = (300, 280)  # more than one square of 256 px each way, and not a multiple of it


@pytest.fixture(scope="module")
def exact():
    """The still image without rounding, as float32."""
    return render(STILL, *SIZE, bit_depth=32)


def test_images_are_those_of_earlier_versions():
    # Rounded to 8 bit, so that another machine's last digit does not matter.
    field = Sinusoidal(wavelength_x=(80.0, 90.0), wavelength_y=(85.0, 75.0))
    pair = render_pair(Scene(SpeckleTexture(3), field), Picture(300, 270, Digitiser(noise=1.0, seed=2)))
    digests = [hashlib.sha256(image.tobytes()).hexdigest()[:16] for image in (pair.reference, pair.deformed)]
    assert digests == ["a8a59cdf404821ce", "53300ae2cc359044"]


def test_reference_is_the_texture_at_pixel_centres():
    pair = render(STILL, *SIZE)
    x, y = np.meshgrid(np.arange(300), np.arange(280))
    assert pair.reference.shape == (280, 300)
    np.testing.assert_array_equal(pair.reference, np.rint(255 * TEXTURE.grey(x, y)).astype(np.uint8))
    np.testing.assert_array_equal(pair.deformed, pair.reference)


def test_whole_pixel_translation_shifts_the_picture():
    pair = render(Translation((3.0, -2.0)), *SIZE, bit_depth=16)
    # f(x, y) = g(x + 3, y - 2): whole numbers add without rounding, so the values are the same bits.
    np.testing.assert_array_equal(pair.deformed[:-2, 3:], pair.reference[2:, :-3])
    assert np.mean(pair.deformed == pair.reference) < 0.01


@pytest.mark.parametrize("field", [Sinusoidal(), Affine(((0.02, 0.01), (-0.03, 0.01)), (1.0, 0.4)),
                                   Kirsch((70.0, 60.0), 20.0, 0.03), Bending(2e-4, (60.0, 60.0))],
                         ids=lambda field: type(field).__name__)
def test_grey_levels_are_conserved_off_the_grid(field):
    scene = Scene(TEXTURE, field, Hole((70.0, 60.0), 20.0))
    x = np.random.default_rng(0).uniform(0, 130, (3000, 2))
    # Slopes below 0.5 of full scale per px times the 1e-12 px left by the inversion.
    np.testing.assert_allclose(scene.deformed_grey(x + field.displacement(x)), scene.reference_grey(x),
                               rtol=0, atol=3e-12)


def test_deformed_image_is_the_scene_at_pixel_centres():
    field = Kirsch((150.0, 140.0), 25.0, 0.02)
    hole = Hole(field.center, field.radius)
    pair = render(field, *SIZE, bit_depth=32, hole=hole)
    pixels = np.array([[0.0, 0.0], [299.0, 0.0], [255.0, 256.0], [256.0, 255.0], [299.0, 279.0]])
    grey = 255 * Scene(TEXTURE, field, hole).deformed_grey(pixels)
    columns, rows = pixels.astype(int).T
    np.testing.assert_array_equal(pair.deformed[rows, columns], grey.astype(np.float32))


@pytest.mark.parametrize(("bit_depth", "dtype", "full_scale"), [(8, np.uint8, 255), (16, np.uint16, 65535)])
def test_bit_depths_round_one_picture(exact, bit_depth, dtype, full_scale):
    stored = render(STILL, *SIZE, bit_depth=bit_depth).reference
    assert stored.dtype == dtype
    levels = exact.reference * (full_scale / 255)
    # Half a level, and the rounding of float32 at 255 (1.5e-5, times 257 for 16 bit).
    assert np.abs(stored - levels).max() <= 0.5 + 1e-5 * full_scale / 255
    assert stored.max() > 0.75 * full_scale  # the range is used: bare plate is at 0.814


def test_float_image_spans_0_to_255(exact):
    assert exact.reference.dtype == np.float32
    # Speckles pile up to the darkest level, 0.05; where there is none s = -0.86 and the level is 0.814.
    assert 0.05 * 255 < exact.reference.min() < 0.08 * 255
    assert 0.80 * 255 < exact.reference.max() < 0.8145 * 255


def test_noise_is_gaussian_and_independent_in_both_images(exact):
    pair = render(STILL, *SIZE, bit_depth=32, noise=2.0, seed=4)
    noise = [(image - exact.reference).astype(float) for image in (pair.reference, pair.deformed)]
    n = exact.reference.size
    for sample in noise:
        # Sampling deviations of mean and standard deviation; five of them.
        assert abs(sample.mean()) < 5 * 2 / math.sqrt(n)
        assert sample.std() == pytest.approx(2.0, abs=5 * 2 / math.sqrt(2 * n))
        assert abs(np.mean(sample**4) / 16 - 3) < 5 * math.sqrt(96 / n)
        assert abs(np.mean(sample[:, 1:] * sample[:, :-1])) < 5 * 4 / math.sqrt(n)
        # The squares of 256 px do not repeat one another's noise.
        assert abs(np.corrcoef(sample[:256, :40].ravel(), sample[:256, 256:296].ravel())[0, 1]) < 0.05
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 5 / math.sqrt(n)


def test_noise_is_given_in_8_bit_levels_whatever_the_depth(exact):
    noisy = render(STILL, *SIZE, bit_depth=16, noise=2.0).reference
    sample = noisy / 257.0 - exact.reference
    assert sample.std() == pytest.approx(2.0, abs=5 * 2 / math.sqrt(2 * sample.size))


def test_noise_is_clipped_to_the_range_and_does_not_wrap():
    image = render(STILL, 100, 100, noise=60.0).reference
    assert np.mean(image == 0) > 0.01
    assert np.mean(image == 255) > 0.01


def test_seed_decides_the_noise():
    first, again, other = (render(STILL, 60, 50, noise=2.0, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.reference, again.reference)
    np.testing.assert_array_equal(first.deformed, again.deformed)
    assert np.mean(first.reference != other.reference) > 0.5


def test_hole_is_flat_and_dark_and_moves_with_the_plate():
    field = Translation((5.0, 0.0))
    pair = render(field, 120, 100, bit_depth=32, hole=Hole((60.0, 50.0), 20.0))
    x, y = np.meshgrid(np.arange(120), np.arange(100))
    plain = render(field, 120, 100, bit_depth=32)
    for image, untouched, column in ((pair.reference, plain.reference, 60),
                                     (pair.deformed, plain.deformed, 65)):
        distance = np.hypot(x - column, y - 50) - 20
        # The edge (1 + tanh(d)) / 2 has 1e-7 left at 8 px on either side.
        np.testing.assert_allclose(image[distance < -8], 0.05 * 255, atol=1e-4)
        np.testing.assert_allclose(image[distance > 8], untouched[distance > 8], atol=1e-4)
    # On the very edge: half way between matter and hole.
    assert pair.reference[50, 80] == pytest.approx(0.5 * (plain.reference[50, 80] + 0.05 * 255), abs=1e-4)


@pytest.mark.parametrize("bit_depth", [8, 16, 32])
def test_files_hold_the_same_pair(tmp_path, bit_depth):
    paths = tmp_path / "f.tif", tmp_path / "g.tif"
    scene = Scene(TEXTURE, Sinusoidal(), Hole((100.0, 90.0), 30.0))
    picture = Picture(270, 600, Digitiser(bit_depth, noise=1.5, seed=3))
    write_pair(paths, scene, picture)
    pair = render_pair(scene, picture)
    for path, image in zip(paths, (pair.reference, pair.deformed), strict=True):
        stored = tifffile.imread(path)
        assert stored.dtype == image.dtype
        np.testing.assert_array_equal(stored, image)
        with tifffile.TiffFile(path) as file:
            assert file.pages.first.compression == 1
            assert file.pages.first.is_contiguous


def test_a_failure_leaves_no_half_written_image(tmp_path):
    folded = Sinusoidal(amplitude=(60.0, 0.0), wavelength_x=(100.0, 100.0))
    with pytest.raises(InputError, match="folds"):
        write_pair((tmp_path / "f.tif", tmp_path / "g.tif"), Scene(TEXTURE, folded), Picture(300, 300))
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_missing_is_named(tmp_path):
    with pytest.raises(InputError, match="nowhere"):
        write_pair((tmp_path / "nowhere" / "f.tif", tmp_path / "g.tif"), Scene(TEXTURE, STILL), Picture(30, 30))


@pytest.mark.parametrize(("options", "key"), [
    ({"bit_depth": 12}, "bit_depth"), ({"noise": -1.0}, "noise"), ({"noise": math.nan}, "noise"),
    ({"seed": -1}, "seed"), ({"width": 0}, "size"), ({"height": -3}, "size")])
def test_impossible_images_are_refused(options, key):
    size = {"width": options.pop("width", 20), "height": options.pop("height", 20)}
    with pytest.raises(InputError, match=key):
        render(STILL, **size, **options)


@pytest.mark.parametrize(("arguments", "key"), [
    ({"radius": 0.0}, "radius"), ({"level": 1.5}, "level"), ({"edge": -1.0}, "edge"),
    ({"center": (math.inf, 0.0)}, "center")])
def test_impossible_holes_are_refused(arguments, key):
    with pytest.raises(InputError, match=key):
        Hole(**{"center": (0.0, 0.0), "radius": 5.0, **arguments})

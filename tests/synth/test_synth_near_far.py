import math

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

from ddic.errors import InputError
from ddic.synth.fields import Hole, Kirsch, Translation
from ddic.synth.near_far_scene import (
    NearCamera,
    SetUpMotion,
    build_near_far_scene,
    build_near_mapping,
    place_beside_hole,
    write_near_far,
)
from ddic.synth.render import Digitiser, Picture
from ddic.synth.speckle import SpeckleTexture, TwoScaleTexture, two_scale_texture

RATIO = 5.0
FIELD = Kirsch((70.0, 55.0), 20.0, 0.02, translation=(0.4, -0.3))
FOCUS = (100.0, 55.0)


def picture(width=140, height=110, bit_depth=32, noise=0.0, seed=3):
    return Picture(width, height, Digitiser(bit_depth, noise, seed))


def build(*, field=FIELD, alpha=(3.7, -2.2), rotation=0.0, angle=0.0, tilt=(0.0, 0.0), seed=3, **near):
    near_picture = picture(**{"width": 280, "height": 150, "seed": seed, **near})
    mapping = build_near_mapping(RATIO, FOCUS, near_picture, angle, tilt)
    camera = NearCamera(mapping, SetUpMotion(alpha, rotation, FOCUS), near_picture)
    return build_near_far_scene(two_scale_texture(RATIO, seed), field, Hole((70.0, 55.0), 20.0), picture(seed=seed),
                                camera)


CAMERAS = pytest.mark.parametrize("options", [
    {}, {"rotation": 1.5}, {"tilt": (0.02, -0.03), "angle": 4.0, "rotation": -2.0}],
    ids=["upright", "turning", "tilted"])


@CAMERAS
def test_grey_levels_are_conserved_in_both_cameras(options):
    scene = build(**options)
    points = np.random.default_rng(0).uniform((60, 35), (139, 75), (4000, 2))
    moved = points + FIELD.displacement(points)
    # Slopes below 0.5 of full scale per far px times the 1e-12 px left by the inversion.
    np.testing.assert_allclose(scene.far.deformed_grey(moved), scene.far.reference_grey(points), rtol=0, atol=3e-12)
    near, camera = scene.near, scene.near.camera
    seen, seen_moved = camera.mapping.to_image(points), camera.mapping.to_image(camera.motion.move(moved))
    # Slopes are five times as steep in the specimen's frame.
    np.testing.assert_allclose(near.deformed_grey(seen_moved), near.reference_grey(seen), rtol=0, atol=1.5e-11)
    np.testing.assert_allclose(seen + near.displacement(seen), seen_moved, rtol=0, atol=1e-10)


@given(alpha=st.tuples(*2 * [st.floats(-20, 20)]), degrees=st.floats(-30, 30))
def test_the_motion_and_its_inverse(alpha, degrees):
    motion = SetUpMotion(alpha, degrees, FOCUS)
    points = np.array([[0.0, 0.0], FOCUS, (139.0, 20.0)])
    moved = motion.move(points)
    np.testing.assert_allclose(moved[1] - FOCUS, alpha, atol=1e-13)
    np.testing.assert_allclose(motion.move_back(moved), points, atol=1e-12)
    arm, moved_arm = points[2] - points[0], moved[2] - moved[0]
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    np.testing.assert_allclose(moved_arm, [c * arm[0] - s * arm[1], s * arm[0] + c * arm[1]], atol=1e-12)


def test_the_mapping_is_upright_by_default_and_centres_the_near_field():
    near = picture(280, 150)
    mapping = build_near_mapping(RATIO, FOCUS, near)
    np.testing.assert_allclose(mapping.homography, [[5, 0, 139.5 - 500], [0, 5, 74.5 - 275], [0, 0, 1]], rtol=1e-15)
    tilted = build_near_mapping(RATIO, FOCUS, near, 4.0, (0.02, -0.03))
    np.testing.assert_allclose(tilted.to_image(np.array([FOCUS])), [near.middle], atol=1e-11)
    jacobian = tilted.jacobian(np.array([FOCUS]))[0]
    c, s = 5 * math.cos(math.radians(4)), 5 * math.sin(math.radians(4))
    np.testing.assert_allclose(jacobian, [[c, -s], [s, c]], atol=1e-12)


def test_a_tilted_camera_is_farther_from_the_right_edge():
    near = picture(280, 150)
    right, left = build_near_mapping(RATIO, FOCUS, near, tilt=(0.02, 0.0)).to_image(
        np.array([[100.0 + 28, 55.0], [100.0 - 28, 55.0]]))
    # 28 far px from the centre, half the near field's width: 140 near px without tilt.
    assert right[0] - 139.5 == pytest.approx(140 / 1.02, abs=1e-10)
    assert left[0] - 139.5 == pytest.approx(-140 / 0.98, abs=1e-10)


def test_the_near_picture_holds_the_far_ones_spots_and_finer_ones():
    scene = build()
    points = np.random.default_rng(1).uniform((100, 10), (130, 100), (20000, 2))
    far = scene.far.reference_grey(points) - 0.5
    near = scene.near.reference_grey(scene.near.camera.mapping.to_image(points)) - 0.5
    fine = near - 0.6 * far
    np.testing.assert_allclose(far, -0.45 * np.tanh(SpeckleTexture(3).evaluate(*points.T)), atol=1e-6)
    # 20000 points on 2700 px^2 of spots of 5 px: about 300 independent ones.
    assert abs(np.corrcoef(far, fine)[0, 1]) < 0.2
    step = np.array([[1.0, 0.0]])
    slope = np.abs(np.diff([scene.near.reference_grey(scene.near.camera.mapping.to_image(points) + k * step)
                            for k in (0, 1)], axis=0)).mean()
    coarse_slope = 0.6 * np.abs(scene.far.reference_grey(points + step / RATIO) - far - 0.5).mean()
    # The fine spots are five times as steep at 0.4 to 0.6 of the contrast.
    assert slope > 3 * coarse_slope


def test_the_fine_spots_are_no_small_copy_of_the_coarse_ones():
    texture = two_scale_texture(RATIO, 3)
    x, y = np.random.default_rng(1).uniform(0, 200, (2, 20000))
    coarse, small_copy = texture.coarse.evaluate(x, y), texture.fine.evaluate(x / RATIO, y / RATIO)
    # 40000 px^2 of spots that correlate over 26 px^2: 1500 independent ones, four sampling deviations.
    assert abs(np.corrcoef(coarse, small_copy)[0, 1]) < 4 / math.sqrt(1500)


def test_the_fine_spots_average_out_over_some_far_pixels():
    scene = build()
    rng = np.random.default_rng(2)
    centres = rng.uniform((100, 20), (125, 90), (50, 2))
    points = (centres[:, None] + rng.uniform(-4, 4, (3000, 2))[None]).reshape(-1, 2)
    coarse = 0.6 * scene.far.reference_grey(points)
    fine = scene.near.reference_grey(scene.near.camera.mapping.to_image(points)) - coarse
    # A Gaussian spot correlates over 4 pi sigma^2: 1.06 px^2 of the 64 px^2 for fine spots, so 0.13 of the deviation
    # is left, and 26 px^2 for coarse ones, which keep 0.6.
    left = [part.reshape(50, -1).mean(axis=1).std() / part.std() for part in (fine, coarse)]
    assert 0.08 < left[0] < 0.2
    assert left[1] > 0.35


def test_the_holes_edge_is_as_sharp_in_near_pixels_as_in_far_ones():
    scene = build(field=Translation())
    rim = np.array([[90.0, 55.0]])
    for view, edge in ((scene.far, rim), (scene.near, scene.near.camera.mapping.to_image(rim))):
        plain = view.texture if view is scene.far else view.surface.texture
        for offset in (-3.0, 0.0, 3.0):
            at = edge + np.array([offset, 0.0])
            specimen = at if view is scene.far else view.camera.mapping.to_specimen(at)
            matter = (view.reference_grey(at) - 0.05) / (plain.grey(*specimen.T) - 0.05)
            assert matter[0] == pytest.approx((1 + math.tanh(offset)) / 2, abs=1e-9)


def test_the_files_are_the_scenes_at_pixel_centres(tmp_path):
    scene = build(tilt=(0.01, 0.02), rotation=0.5)
    paths = write_near_far(tmp_path, scene)
    assert [path.name for path in paths] == [
        "far_reference.tif", "far_deformed.tif", "near_reference.tif", "near_deformed.tif"]
    greys = (scene.far.reference_grey, scene.far.deformed_grey, scene.near.reference_grey, scene.near.deformed_grey)
    for path, grey, (width, height) in zip(paths, greys, 2 * [(140, 110)] + 2 * [(280, 150)], strict=True):
        image = tifffile.imread(path)
        assert image.shape == (height, width)
        assert image.dtype == np.float32
        pixels = np.array([[0.0, 0.0], [width - 1, 0.0], [20.0, 70.0], [width - 1, height - 1]])
        columns, rows = pixels.astype(int).T
        # Neighbouring points are summed in groups: not the same rounding in float64, next float32 at most.
        np.testing.assert_allclose(image[rows, columns], 255 * grey(pixels), rtol=2e-7)


def test_the_seed_decides_the_four_images(tmp_path):
    images = []
    for name, seed in (("a", 4), ("b", 4), ("c", 5)):
        (tmp_path / name).mkdir()
        images.append([tifffile.imread(path) for path in write_near_far(
            tmp_path / name, build(seed=seed, bit_depth=8, noise=2.0, width=100, height=80))])
    for first, again, other in zip(*images, strict=True):
        np.testing.assert_array_equal(first, again)
        assert np.mean(first != other) > 0.5


def test_noise_is_independent_in_the_four_images(tmp_path):
    size = {"width": 140, "height": 110}
    clean, noisy = [], []
    for level, images in ((0.0, clean), (2.0, noisy)):
        near = picture(**size, noise=level)
        camera = NearCamera(build_near_mapping(RATIO, FOCUS, near), SetUpMotion((1.0, 0.0), 0.0, FOCUS), near)
        scene = build_near_far_scene(two_scale_texture(RATIO), FIELD, Hole((70.0, 55.0), 20.0),
                                     picture(noise=2 * level), camera)
        images += [tifffile.imread(path).astype(float) for path in write_near_far(tmp_path, scene)]
    noise = [(b - a).ravel() for a, b in zip(clean, noisy, strict=True)]
    n = noise[0].size
    for sample, level in zip(noise, (4.0, 4.0, 2.0, 2.0), strict=True):
        # Five sampling deviations; four grey levels are clipped nowhere (0.05 of 255 is 13).
        assert sample.std() == pytest.approx(level, abs=5 * level / math.sqrt(2 * n) + 0.01)
    assert np.abs(np.corrcoef(noise) - np.eye(4)).max() < 5 / math.sqrt(n)


def test_the_default_near_field_shows_the_holes_edge_and_plain_material():
    near = picture(1392, 1040)
    centre = place_beside_hole((695.5, 519.5), 104.0, RATIO, near)
    x, y = build_near_mapping(RATIO, centre, near).to_image(np.array([[799.5, 519.5]]))[0]
    assert x == pytest.approx(near.middle[0] - 1392 / 4)
    assert y == pytest.approx(near.middle[1])


@pytest.mark.parametrize(("options", "message"), [
    ({"ratio": 1.0}, "ratio = 1.0"), ({"ratio": math.nan}, "ratio"), ({"ratio": 0.0}, "ratio"),
    ({"centre": (math.inf, 0.0)}, "centre"), ({"angle": math.nan}, "angle"), ({"tilt": (math.nan, 0.0)}, "tilt"),
    ({"tilt": (1.0, 0.0)}, "horizon")])
def test_impossible_cameras_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        build_near_mapping(options.get("ratio", RATIO), options.get("centre", FOCUS), picture(280, 150),
                           options.get("angle", 0.0), options.get("tilt", (0.0, 0.0)))


@pytest.mark.parametrize("near", [{"width": 500}, {"height": 600}, {"angle": 85.0, "width": 200, "height": 400}])
def test_a_near_field_beyond_the_far_image_is_refused(near):
    with pytest.raises(InputError, match="outside the far image"):
        build(**near)


def test_a_motion_that_is_not_finite_is_refused():
    with pytest.raises(InputError, match="alpha"):
        SetUpMotion((math.nan, 0.0))
    with pytest.raises(InputError, match="rotation_degrees"):
        SetUpMotion((0.0, 0.0), math.inf)


@pytest.mark.parametrize("share", [-0.1, 1.1, math.nan])
def test_an_impossible_share_is_refused(share):
    with pytest.raises(InputError, match="fine_share"):
        TwoScaleTexture(SpeckleTexture(), SpeckleTexture(1), share)

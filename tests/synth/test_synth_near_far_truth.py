import json

import numpy as np
import pytest

from ddic.errors import InputError
from ddic.io.text_files import write_json
from ddic.synth.fields import Hole, Kirsch, Translation
from ddic.synth.near_far_scene import NearCamera, SetUpMotion, build_near_far_scene, build_near_mapping
from ddic.synth.render import Digitiser, Picture, Scene
from ddic.synth.speckle import SpeckleTexture, two_scale_texture
from ddic.synth.truth import describe_near_far, describe_pair, load_near_far_truth, load_truth

FOCUS = (100.0, 55.0)
FIELD = Kirsch((70.0, 55.0), 20.0, 0.02)
MOTION = SetUpMotion((3.7, -2.2), 0.5, FOCUS)


@pytest.fixture
def scene():
    near = Picture(280, 150, Digitiser(16, 1.0, 7))
    camera = NearCamera(build_near_mapping(5.0, FOCUS, near, 3.0, (0.01, -0.02)), MOTION, near)
    far = Picture(140, 110, Digitiser(8, 2.0, 7))
    return build_near_far_scene(two_scale_texture(5.0, 7, 1.5), FIELD, Hole((70.0, 55.0), 20.0), far, camera)


@pytest.fixture
def path(tmp_path, scene):
    write_json(tmp_path / "truth.json", describe_near_far(scene))
    return tmp_path / "truth.json"


def test_field_mapping_and_motion_are_rebuilt_exactly(path, scene):
    truth = load_near_far_truth(path)
    assert truth.field == FIELD
    assert truth.motion == MOTION
    assert truth.near_size == (280, 150)
    np.testing.assert_array_equal(truth.mapping.homography, scene.near.camera.mapping.homography)
    assert load_truth(path) == FIELD


def test_the_rebuilt_displacements_are_those_of_the_images(path, scene):
    truth = load_near_far_truth(path)
    points = np.random.default_rng(0).uniform((75, 42), (125, 68), (500, 2))
    np.testing.assert_array_equal(truth.displacement(points), FIELD.displacement(points))
    np.testing.assert_array_equal(truth.gradient(points), FIELD.gradient(points))
    seen = truth.mapping.to_image(points)
    u = truth.mapping.to_image(truth.motion.move(points + truth.displacement(points))) - seen
    np.testing.assert_allclose(u, scene.near.displacement(seen), rtol=0, atol=1e-10)
    # Alpha alone is 18.5 and -11 near px.
    assert np.abs(u - [18.5, -11.0]).max() < 10
    np.testing.assert_allclose(scene.near.deformed_grey(seen + u), scene.near.reference_grey(seen), rtol=0, atol=1e-10)


def test_everything_that_made_the_images_is_recorded(path):
    record = json.loads(path.read_text())
    assert record["texture"] == {"seed": 7, "size_factor": 1.5}
    assert record["image"] == {"width": 140, "height": 110, "bit_depth": 8, "noise": 2.0, "seed": 7}
    near = record["near"]
    assert near["image"] == {"width": 280, "height": 150, "bit_depth": 16, "noise": 1.0, "seed": 7}
    assert near["motion"] == {"alpha": [3.7, -2.2], "rotation_degrees": 0.5, "centre": [100.0, 55.0]}
    assert near["texture"]["coarse"] == record["texture"]
    assert near["texture"]["fine"]["size_factor"] == pytest.approx(0.3)
    assert near["hole"]["edge"] == pytest.approx(0.2)


def spoil(near, *keys, value=None):
    for key in keys[:-1]:
        near = near[key]
    if value is None:
        del near[keys[-1]]
    else:
        near[keys[-1]] = value


@pytest.mark.parametrize(("keys", "value", "message"), [
    (("mapping",), None, "mapping"), (("motion",), 3, "motion"), (("image", "width"), None, "width"),
    (("mapping", "homography"), [[1, 0], [0, 1]], "homography"), (("mapping", "scale"), 3.0, "scale"),
    (("motion", "alpha"), "ab", "near.motion"), (("motion", "alpha"), [float("nan"), 0.0], "alpha"),
    (("motion", "angle"), 1.0, "angle"), (("image", "height"), "tall", "tall"), (("image",), None, "image")])
def test_wrong_values_are_named(path, keys, value, message):
    record = json.loads(path.read_text())
    spoil(record["near"], *keys, value=value)
    path.write_text(json.dumps(record))
    with pytest.raises(InputError, match=message) as caught:
        load_near_far_truth(path)
    assert str(path) in str(caught.value)


def test_the_truth_of_a_single_pair_is_refused(tmp_path):
    path = tmp_path / "truth.json"
    write_json(path, describe_pair(Scene(SpeckleTexture(), Translation()), Picture(30, 20)))
    with pytest.raises(InputError, match="near: is missing"):
        load_near_far_truth(path)

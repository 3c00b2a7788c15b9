import json
from dataclasses import dataclass

import numpy as np
import pytest

from ddic.errors import InputError
from ddic.io.text_files import write_json
from ddic.synth.fields import Affine, Bending, Hole, Kirsch, Sinusoidal, Sum, Translation
from ddic.synth.render import Digitiser, Picture, Scene
from ddic.synth.speckle import SpeckleTexture
from ddic.synth.truth import describe_pair, load_truth


@dataclass(frozen=True)
class Unnamed:
    def displacement(self, points):
        return np.zeros_like(points)

    def gradient(self, points):
        return np.zeros((len(points), 2, 2))


def save(path, field):
    scene = Scene(SpeckleTexture(7, 1.5), field, Hole((10.0, 20.0), 5.0))
    write_json(path, describe_pair(scene, Picture(640, 480, Digitiser(16, 2.0, 7))))


@pytest.mark.parametrize("field", [
    Translation((0.1, -3.0)), Affine(((0.1, 0.2), (0.3, 1 / 3)), (1.0, 2.0), (3.0, 4.0)), Sinusoidal(),
    Kirsch((1 / 3, 2.0), 30.0, 0.01, 0.25, (0.5, 0.6)), Bending(1e-5 / 3, (5.0, 6.0), 0.2),
    Sum((Translation((1.0, 2.0)), Sum((Bending(), Kirsch())))),
    Sinusoidal((0.1,) * 3, (1.0,) * 3, (90.0,) * 3, (80.0,) * 3, (0.1,) * 3, (0.2,) * 3, (70.0,) * 3, (1 / 3,) * 3)],
    ids=lambda field: type(field).__name__)
def test_the_exact_field_is_rebuilt(tmp_path, field):
    save(tmp_path / "truth.json", field)
    assert load_truth(tmp_path / "truth.json") == field


def test_everything_that_made_the_pair_is_recorded(tmp_path):
    save(tmp_path / "truth.json", Translation((1.0, 0.0)))
    record = json.loads((tmp_path / "truth.json").read_text())
    assert record["texture"] == {"seed": 7, "size_factor": 1.5}
    assert record["hole"] == {"center": [10.0, 20.0], "radius": 5.0, "level": 0.05, "edge": 1.0}
    assert record["image"] == {"width": 640, "height": 480, "bit_depth": 16, "noise": 2.0, "seed": 7}


def test_waves_of_the_plane_have_no_third_axis_and_volumes_a_depth():
    scene = Scene(SpeckleTexture(), Sinusoidal())
    assert not [key for key in describe_pair(scene, Picture(4, 3))["field"] if key.endswith("_z")]
    image = describe_pair(scene, Picture(4, 3, depth=2))["image"]
    assert [image[key] for key in ("width", "height", "depth")] == [4, 3, 2]


@pytest.mark.parametrize(("content", "message"), [
    ("{", "cannot be read as JSON"), ("[1]", "format"), ('{"format": "other"}', "format"),
    ('{"format": "ddic-truth", "version": 9}', "version = 9"),
    ('{"format": "ddic-truth", "version": 1}', "field.name"),
    ('{"format": "ddic-truth", "version": 1, "field": {"name": ["kirsch"]}}', "field.name"),
    ('{"format": "ddic-truth", "version": 1, "field": {"name": "kirsch", "radius": -1}}', "radius = -1"),
    ('{"format": "ddic-truth", "version": 1, "field": {"name": "kirsch", "raduis": 1}}', "raduis"),
    ('{"format": "ddic-truth", "version": 1, "field": {"name": "sum", "terms": 3}}', "field.terms"),
    ('{"format": "ddic-truth", "version": 1, "field": {"name": "translation", "vector": "ab"}}', "field")])
def test_foreign_and_wrong_files_are_named(tmp_path, content, message):
    path = tmp_path / "truth.json"
    path.write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        load_truth(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"absent\.json"):
        load_truth(tmp_path / "absent.json")


def test_an_unnamed_field_is_refused(tmp_path):
    with pytest.raises(InputError, match="Unnamed"):
        save(tmp_path / "truth.json", Unnamed())


def test_an_unwritable_folder_is_named(tmp_path):
    with pytest.raises(InputError, match="nowhere"):
        save(tmp_path / "nowhere" / "truth.json", Translation())

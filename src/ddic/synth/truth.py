"""The truth file: everything needed to rebuild the exact displacement of a generated pair, or of a near and far one."""

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.images.camera import CameraMapping
from ddic.synth.fields import Affine, Bending, DisplacementField, Kirsch, Sinusoidal, Sum, Translation
from ddic.synth.near_far_scene import NearFarScene, SetUpMotion
from ddic.synth.render import Picture, Scene

_FORMAT = "ddic-truth"
_VERSION = 1
_FIELDS: dict[str, type[Any]] = {
    "translation": Translation, "affine": Affine, "sinusoidal": Sinusoidal, "kirsch": Kirsch,
    "bending": Bending, "sum": Sum}
_NAMES = {kind: name for name, kind in _FIELDS.items()}


def describe_pair(scene: Scene, picture: Picture) -> dict[str, Any]:
    """Describe all that made a pair as JSON holds it: a truth file's record; InputError for a field of one's own."""
    size = dict(zip(("width", "height", "depth"), picture.extent.sizes, strict=False))
    return {
        "format": _FORMAT,
        "version": _VERSION,
        "field": _describe(scene.field),
        "texture": dataclasses.asdict(scene.texture),
        "hole": None if scene.hole is None else dataclasses.asdict(scene.hole),
        "image": {**size, **dataclasses.asdict(picture.digitiser)},
    }


def load_truth(path: Path) -> DisplacementField:
    """Rebuild exactly the displacement field that a truth file describes.

    Raises InputError, naming file and key, if the file is missing, foreign, or has an impossible value.
    """
    return _rebuild(path, _read_record(path).get("field"))


def _read_record(path: Path) -> dict[str, Any]:
    """Read the values of a truth file; raises InputError if it is missing or foreign."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as JSON ({error}); give the truth.json "
                         "that ddic synth wrote") from error
    if not isinstance(record, dict) or record.get("format") != _FORMAT:
        raise InputError(f'{path}: format: is not "{_FORMAT}"; give the truth.json that ddic synth wrote')
    if record.get("version") != _VERSION:
        raise InputError(f"{path}: version = {record.get('version')}: this ddic reads version {_VERSION}")
    return record


def _describe(field: DisplacementField) -> dict[str, Any]:
    """Name and parameters of a field."""
    name = _NAMES.get(type(field))
    if name is None:
        raise InputError(f"{type(field).__name__}: has no name in a truth file; use one of {list(_FIELDS)}")
    if isinstance(field, Sum):
        return {"name": name, "terms": [_describe(term) for term in field.terms]}
    values = {item.name: getattr(field, item.name) for item in dataclasses.fields(_FIELDS[name])}
    return {"name": name, **{key: value for key, value in values.items() if value is not None}}


def _rebuild(path: Path, description: object) -> DisplacementField:
    """Inverse of ``_describe``; path: for errors."""
    name = description.get("name") if isinstance(description, dict) else None
    if not isinstance(description, dict) or not isinstance(name, str) or name not in _FIELDS:
        raise InputError(f"{path}: field.name: is not one of {', '.join(_FIELDS)}")
    values = {key: _as_tuples(value) for key, value in description.items() if key != "name"}
    kind = _FIELDS[name]
    if kind is Sum:
        terms = description.get("terms")
        if not isinstance(terms, list):
            raise InputError(f"{path}: field.terms: must be a list of displacement fields")
        values["terms"] = tuple(_rebuild(path, term) for term in terms)
    try:
        field: DisplacementField = kind(**values)
    except InputError as error:
        raise InputError([f"{path}: {problem}" for problem in error.problems]) from error
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: field: {error}; give the truth.json that ddic synth wrote") from error
    return field


def _as_tuples(value: Any) -> Any:
    """Turn lists into tuples, which JSON does not have, at any depth."""
    return tuple(_as_tuples(item) for item in value) if isinstance(value, list) else value


Built = TypeVar("Built")
_REMEDY = "give the truth.json that ddic synth near-far wrote"


@dataclass(frozen=True, eq=False)
class NearFarTruth:
    """What a near-field and far-field measurement should find.

    Attributes
    ----------
    field : DisplacementField
        u, specimen's frame, which is the far camera's pixels.
    mapping : CameraMapping
        phi, from there to the near camera's pixels.
    motion : SetUpMotion
        T, of the near set-up between its two pictures.
    near_size : (int, int)
        Width and height of the near image, pixels.
    """

    field: DisplacementField
    mapping: CameraMapping
    motion: SetUpMotion
    near_size: tuple[int, int]

    def displacement(self, points: Array) -> Array:
        """Evaluate the displacement u, far pixels, at points X, (n, 2), pixels of the specimen's frame."""
        return self.field.displacement(points)

    def gradient(self, points: Array) -> Array:
        """Evaluate the gradient du_i/dX_j, (n, 2, 2), no unit, at points X, pixels of the specimen's frame."""
        return self.field.gradient(points)


def describe_near_far(scene: NearFarScene) -> dict[str, Any]:
    """Describe fields, textures, holes, cameras and the set-up's motion, as values that JSON holds.

    The far pair is described as ``describe_pair`` does it, the near pair likewise under ``near``, where ``mapping`` is
    phi and ``motion`` is T; the displacement of both is the one of the specimen's frame. Raises
    InputError if the field is not one of this package's.
    """
    camera = scene.near.camera
    record = describe_pair(scene.far, scene.far_picture)
    of_near = describe_pair(scene.near.surface, camera.picture)
    record["near"] = {
        **{key: of_near[key] for key in ("texture", "hole", "image")},
        "mapping": {key: np.asarray(value).tolist() for key, value in dataclasses.asdict(camera.mapping).items()},
        "motion": dataclasses.asdict(camera.motion),
    }
    return record


def load_near_far_truth(path: Path) -> NearFarTruth:
    """Rebuild the exact fields that a truth file of ``ddic synth near-far`` describes.

    Raises InputError, naming file and key, if the file is missing, foreign, or has an impossible value.
    """
    field = load_truth(path)
    near = _read_record(path).get("near")
    if not isinstance(near, dict):
        raise InputError(f"{path}: near: is missing; {_REMEDY}")
    mapping = _rebuild_near(path, near, "mapping", CameraMapping)
    motion = _rebuild_near(path, near, "motion", SetUpMotion)
    size = _rebuild_near(path, near, "image", lambda width, height, **_rest: (int(width), int(height)))
    return NearFarTruth(field, mapping, motion, size)


def _rebuild_near(path: Path, near: dict[str, Any], key: str, kind: Callable[..., Built]) -> Built:
    """Make an object of the values under a key of the near part; path: for errors."""
    values = near.get(key)
    if not isinstance(values, dict):
        raise InputError(f"{path}: near.{key}: is missing; {_REMEDY}")
    try:
        return kind(**{name: _as_tuples(value) for name, value in values.items()})
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"{path}: near.{key}: {error}; {_REMEDY}") from error

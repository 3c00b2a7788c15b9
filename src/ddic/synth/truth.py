"""The truth file: everything needed to rebuild a generated pair's exact displacement field."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from ddic.errors import InputError
from ddic.io.json_file import write_json
from ddic.synth.fields import Affine, Bending, DisplacementField, Sinusoidal, Sum, Translation
from ddic.synth.kirsch import Kirsch
from ddic.synth.picture import Picture
from ddic.synth.render import Scene

_FORMAT = "ddic-truth"
_VERSION = 1
_FIELDS: dict[str, type[Any]] = {
    "translation": Translation, "affine": Affine, "sinusoidal": Sinusoidal, "kirsch": Kirsch,
    "bending": Bending, "sum": Sum}
_NAMES = {kind: name for name, kind in _FIELDS.items()}


def save_truth(path: Path, scene: Scene, picture: Picture) -> None:
    """Write field, texture, hole and camera of a generated pair as JSON.

    Parameters
    ----------
    path : Path
        The truth file.
    scene : Scene
        What was rendered.
    picture : Picture
        Size, bit depth and noise of the images.

    Raises
    ------
    InputError
        If the field is not one of this package's, or the folder cannot be written to.
    """
    write_json(path, describe_pair(scene, picture))


def describe_pair(scene: Scene, picture: Picture) -> dict[str, Any]:
    """Describe everything that made a pair, as values that JSON holds.

    Parameters
    ----------
    scene : Scene
        What was rendered.
    picture : Picture
        Size, bit depth and noise of the images.

    Returns
    -------
    dict
        A truth file's record.

    Raises
    ------
    InputError
        If the field is not one of this package's.
    """
    size = {"width": picture.width, "height": picture.height}
    return {
        "format": _FORMAT,
        "version": _VERSION,
        "field": _describe(scene.field),
        "texture": dataclasses.asdict(scene.texture),
        "hole": None if scene.hole is None else dataclasses.asdict(scene.hole),
        "image": {**size, **dataclasses.asdict(picture.digitiser)},
    }


def load_truth(path: Path) -> DisplacementField:
    """Rebuild the displacement field that a truth file describes.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    DisplacementField
        Exactly the one that made the images.

    Raises
    ------
    InputError
        If the file is missing, foreign, or has an impossible value; it names file and key.
    """
    return _rebuild(path, read_record(path).get("field"))


def read_record(path: Path) -> dict[str, Any]:
    """Read the values of a truth file.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    dict
        As it was written.

    Raises
    ------
    InputError
        If the file is missing or foreign.
    """
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
    return {"name": name, **values}


def _rebuild(path: Path, description: object) -> DisplacementField:
    """Inverse of ``_describe``; path: for errors."""
    name = description.get("name") if isinstance(description, dict) else None
    if not isinstance(description, dict) or not isinstance(name, str) or name not in _FIELDS:
        raise InputError(f"{path}: field.name: is not one of {', '.join(_FIELDS)}")
    values = {key: as_tuples(value) for key, value in description.items() if key != "name"}
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


def as_tuples(value: Any) -> Any:
    """Turn lists into tuples, which JSON does not have.

    Parameters
    ----------
    value : object
        As JSON gives it.

    Returns
    -------
    object
        The same with tuples in place of lists, at any depth.
    """
    return tuple(as_tuples(item) for item in value) if isinstance(value, list) else value

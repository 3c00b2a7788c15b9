"""Case files: read, checked against the schema, paths made absolute."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from ddic.case.messages import describe
from ddic.case.schema import Case
from ddic.errors import InputError

DETECT = "detect"
"""In place of discontinuities: one line, found by itself."""

Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True)
class LoadedCase:
    """A validated case.

    Attributes
    ----------
    case : Case
        Its values, all paths absolute.
    path : Path
        The file.
    text : str
        The file's content, as it was read.
    """

    case: Case
    path: Path
    text: str


def load_case(path: Path | str) -> LoadedCase:
    """Read a TOML case file; relative paths in it are relative to its folder.

    Parameters
    ----------
    path : Path or str
        The file.

    Returns
    -------
    LoadedCase
        With all paths absolute.

    Raises
    ------
    InputError
        With one line per problem (unreadable file, syntax, unknown or missing key, wrong type, impossible value),
        each with the file, the key, the value and what is expected.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot read this case file ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text (byte {error.start}); save it as UTF-8") from error
    case = parse_case(text, path)
    return LoadedCase(_absolute(case, path.resolve().parent), path.resolve(), text)


def parse_case(text: str, path: Path) -> Case:
    """Validate the text of a case file.

    Parameters
    ----------
    text : str
        TOML.
    path : Path
        Names the file in messages.

    Returns
    -------
    Case
        With paths as they are written.

    Raises
    ------
    InputError
        As ``load_case`` does.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error
    word = data.get("discontinuity")
    if isinstance(word, str) and word != DETECT:
        raise InputError(f'{path}: discontinuity = "{word}": write "{DETECT}", or [[discontinuity]] sections')
    data = convert_shorthand(data)
    try:
        # Only pydantic's JSON mode is strict about types ("8" is not 8) and yet takes lists for tuples.
        return Case.model_validate_json(json.dumps(data, default=_no_json_type), strict=True)
    except ValidationError as error:
        raise InputError([f"{path}: {line}" for line in describe(error, data)]) from error


def convert_shorthand(data: Mapping[str, Any]) -> dict[str, Any]:
    """Write out what a case may say in a word.

    Parameters
    ----------
    data : mapping
        Sections and keys, not validated.

    Returns
    -------
    dict
        With a section without vertices for ``discontinuity = "detect"``.
    """
    return {**data, "discontinuity": [{}]} if data.get("discontinuity") == DETECT else dict(data)


def _no_json_type(value: object) -> list[list[object]]:
    """Stand in for TOML's dates and times, which no key takes: a value that every key refuses."""
    return [[]]


def _absolute(model: Model, folder: Path) -> Model:
    """The same section with absolute paths."""
    changes = {name: _absolute_value(getattr(model, name), folder) for name in type(model).model_fields}
    return model.model_copy(update=changes)


def _absolute_value(value: Any, folder: Path) -> Any:
    """The same value with absolute paths in it, at any depth."""
    if isinstance(value, Path):
        return (folder / value).resolve()
    if isinstance(value, BaseModel):
        return _absolute(value, folder)
    if isinstance(value, tuple):
        return tuple(_absolute_value(item, folder) for item in value)
    return value

"""Case files: read, checked against the schema, paths made absolute."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from ddic.case.frame_files import find_frames, is_pattern, is_series
from ddic.case.messages import describe, remove_kinds
from ddic.case.schema import Case, OutputSection
from ddic.case.sections import Location, find_section_in
from ddic.errors import InputError
from ddic.io.input_file import FileStamps, as_path, find_real_path, is_readable_file
from ddic.io.text_files import parse_toml, read_text
from ddic.mesh.mesh import Mesh
from ddic.partition.ties import Tying

DETECT = "detect"
"""In place of discontinuities: one line, found by itself."""

MOST_REPAIRS = 5
"""Times that bad keys are taken out of a case to see what else is wrong: some show only when others are gone."""

Model = TypeVar("Model", bound=BaseModel)


@dataclass
class KeptMesh:
    """What was built of a case when it was checked: the measurement needs the same and takes it, once.

    It stays on the rank that checked: pickled, as other ranks get a case, it is empty.
    """

    _case: Case | None = None
    _built: tuple[Mesh, Tying | None] | None = None

    def keep(self, case: Case, mesh: Mesh, tying: Tying | None) -> None:
        """Keep the mesh of a case, in place of any other.

        Parameters
        ----------
        case : Case
            That it was built of.
        mesh : Mesh
            The whole mesh, pixels.
        tying : Tying or None
            How near fields' own meshes are tied in it; None where there are none.
        """
        self._case, self._built = case, (mesh, tying)

    def take(self, case: Case) -> tuple[Mesh, Tying | None] | None:
        """Give the mesh of a case away, so that its memory is the taker's.

        Parameters
        ----------
        case : Case
            That is measured.

        Returns
        -------
        tuple of Mesh and Tying or None
            As ``build_meshes`` would build it; None where no mesh of this very case is kept.
        """
        if self._case is not case:
            return None
        built, self._case, self._built = self._built, None, None
        return built

    def __reduce__(self) -> tuple[type[KeptMesh], tuple[()]]:
        return KeptMesh, ()


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
    stamps : FileStamps
        Of what it names, when that was checked; empty before.
    kept_mesh : KeptMesh
        Its mesh, where that was built for the check; only there.
    """

    case: Case
    path: Path
    text: str
    stamps: FileStamps = field(default_factory=FileStamps)
    kept_mesh: KeptMesh = field(default_factory=KeptMesh, compare=False)

    @property
    def is_series(self) -> bool:
        """Whether it names several deformed images."""
        return is_series(self.case)

    def with_output(self, file: Path) -> LoadedCase:
        """Have the result written elsewhere.

        Parameters
        ----------
        file : Path
            The result file.

        Returns
        -------
        LoadedCase
            The same but for ``output.file``.
        """
        output = self.case.output.model_copy(update={"file": file})
        return replace(self, case=self.case.model_copy(update={"output": output}))


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
    path = as_path(path, "case file")
    text = read_text(path, "case file", "check the path")
    place = path.resolve()
    _require_text_name(place)
    case = _absolute(parse_case(text, path), place.parent)
    return LoadedCase(find_frames(case, path), place, text)


def load_case_leniently(path: Path | str) -> tuple[LoadedCase | None, list[str]]:
    """Read a case file as far as it can be read, so that what else is wrong can be told beside its bad keys.

    Parameters
    ----------
    path : Path or str
        The file.

    Returns
    -------
    loaded : LoadedCase or None
        The case without its bad keys, not to be run where there are any; None where it makes no sense without them.
    problems : list of str
        Of the keys, one line each.
    """
    try:
        return load_case(path), []
    except InputError as error:
        problems = list(error.problems)
    path = Path(path)
    try:
        text = read_text(path, "case file", "check the path")
        _require_text_name(path.resolve())
        data = convert_shorthand(parse_toml(text, path))
    except InputError:
        return None, problems
    folder = path.resolve().parent
    missing = [f"{file}: no such file; check the path" for file in _list_named_files(data, Case, folder)
               if not is_readable_file(file) and not is_pattern(file)]
    case = _validate_without_bad_keys(data)
    if case is None:
        # Little else can be said of it.
        return None, [*problems, *missing]
    case = _absolute(case, folder)
    try:
        case = find_frames(case, path)
    except InputError as error:
        return None, [*problems, *(line for line in error.problems if line not in problems)]
    return LoadedCase(case, path.resolve(), text), problems


def _validate_without_bad_keys(data: dict[str, Any]) -> Case | None:
    """The case that is left without what is wrong; what one bad key hides may be wrong too."""
    for _ in range(MOST_REPAIRS):
        try:
            return _validate(data)
        except ValidationError as error:
            locations = [problem["loc"] for problem in error.errors() if problem["type"] != "missing"]
        if not locations:
            return None
        for location in [remove_kinds(location, data) for location in locations]:
            _remove(data, location)
    return None


def _list_named_files(data: Any, section: type[BaseModel], folder: Path) -> Iterator[Path]:
    """Input files that a case names, wherever else it is wrong; absolute."""
    if isinstance(data, list):
        for item in data:
            yield from _list_named_files(item, section, folder)
    if not isinstance(data, dict):
        return
    for key, value in data.items():
        field = section.model_fields.get(key)
        inner = None if field is None else find_section_in(field.annotation)
        if inner is not None and inner is not OutputSection:
            yield from _list_named_files(value, inner, folder)
        elif field is not None and _takes_path(field.annotation) and isinstance(value, str):
            yield _locate(value, folder)
        elif field is not None and _takes_path(field.annotation) and isinstance(value, list):
            yield from (_locate(item, folder) for item in value if isinstance(item, str))


def _locate(value: Path | str, folder: Path) -> Path:
    return find_real_path(folder / value)


def _require_text_name(path: Path) -> None:
    """Refuse a case in a folder whose name is no text, which results and messages could not hold."""
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError as error:
        name = str(path).encode("utf-8", "backslashreplace").decode()
        raise InputError(f"{name}: the path of this case file is no UTF-8 text, which results name; rename the folder "
                         "or the file") from error


def _takes_path(annotation: Any) -> bool:
    return annotation is Path or any(_takes_path(inner) for inner in get_args(annotation))


def _remove(data: Any, location: Location) -> None:
    """Remove a key; what a list holds goes with the whole list, whose places would else change their meaning."""
    keys = location[:next((k for k, step in enumerate(location) if isinstance(step, int)), len(location))]
    for step in keys[:-1]:
        # What one problem has removed, the next one may lie in.
        data = data.get(step, {})
    if keys:
        data.pop(keys[-1], None)


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
    data = parse_toml(text, path)
    word = data.get("discontinuity")
    if isinstance(word, str) and word != DETECT:
        raise InputError(f'{path}: discontinuity = "{word}": write "{DETECT}", or [[discontinuity]] sections')
    data = convert_shorthand(data)
    try:
        return _validate(data)
    except ValidationError as error:
        raise InputError([f"{path}: {line}" for line in describe(error, data)]) from error


def _validate(data: Mapping[str, Any]) -> Case:
    # Only pydantic's JSON mode is strict about types ("8" is not 8) and yet takes lists for tuples.
    return Case.model_validate_json(json.dumps(data, default=_no_json_type), strict=True)


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
    values = {name: _absolute_value(getattr(model, name), folder) for name in type(model).model_fields}
    # A copy with other values would forget which keys the file gives.
    return type(model).model_construct(model.model_fields_set, **values)


def _absolute_value(value: Any, folder: Path) -> Any:
    """The same value with absolute paths in it, at any depth."""
    if isinstance(value, Path):
        return _locate(value, folder)
    if isinstance(value, BaseModel):
        return _absolute(value, folder)
    if isinstance(value, tuple):
        return tuple(_absolute_value(item, folder) for item in value)
    return value

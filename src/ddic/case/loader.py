"""Case files: read, checked against the schema, paths made absolute; what is wrong or has no effect, in plain words."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from ddic.case.named_files import find_frames, is_pattern, is_series, list_named_files
from ddic.case.schema import NO_IMAGES, Case, Location, find_section, list_sections
from ddic.errors import InputError, describe_nearest
from ddic.io.input_file import FileStamps, as_path, find_real_path, is_readable_file, list_parts
from ddic.io.text_files import parse_toml, read_text
from ddic.mesh.mesh import Mesh
from ddic.partition.ties import Tying

EXPECTED = {
    "string_type": "a text in quotes",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "tuple_type": "a list in square brackets",
    "model_type": "a section, [name] with keys below it",
    "literal_error": "{expected}",
    "string_pattern_mismatch": "a name in one line",
    "string_too_long": "at most {max_length} characters",
    "greater_than": "more than {gt:g}",
    "greater_than_equal": "at least {ge:g}",
    "less_than": "less than {lt:g}",
    "less_than_equal": "at most {le:g}",
    "too_short": "at least {min_length} items",
    "too_long": "at most {max_length} items",
}
"""What a key takes, by the kind of pydantic's error."""

TOO_SHORT = "too_short"
"""What pydantic calls a list of too few items."""

KINDS = ("one", "several")
"""What the schema calls the two kinds of values that a key may take, which no key is called."""


def describe(error: ValidationError, data: Mapping[str, Any]) -> list[str]:
    """Say what is wrong with a parsed case file, a line per problem: key, value given, what is expected."""
    located = [(_remove_kinds(problem["loc"], data), problem) for problem in error.errors(include_url=False)]
    lines = [_line(location, problem, data) for location, problem in located
             if problem["type"] != TOO_SHORT or _is_too_short(_value_at(data, location), problem)]
    # The schema, which takes one of two sections, is not asked where another one is wrong.
    is_without_images = not {"images", "volumes"} & set(data) and NO_IMAGES not in lines
    return [*([NO_IMAGES] if is_without_images else []), *lines]


def _is_too_short(value: Any, problem: ErrorDetails) -> bool:
    """Whether a list has too few items itself, and not only without the wrong ones, which are told one by one."""
    return isinstance(value, list) and len(value) < problem["ctx"]["min_length"]


def _remove_kinds(location: Location, data: Any) -> Location:
    """Remove from a location what pydantic says of the kind that a value was taken for.

    The keys and places that are left lead to a value of the parsed case file, or to one that is missing.
    """
    kept: list[str | int] = []
    for step in location:
        is_kind = step in KINDS and isinstance(data, Mapping) and step not in data
        if is_kind or not isinstance(data, Mapping if isinstance(step, str) else list):
            continue
        kept.append(step)
        data = _take(data, step)
    return tuple(kept)


def _take(data: Any, step: str | int) -> Any:
    """What a section or a list holds; an empty section where it holds nothing there."""
    try:
        return data[step]
    except (KeyError, IndexError):
        return {}


def _line(location: Location, problem: ErrorDetails, data: Mapping[str, Any]) -> str:
    """One problem in one line."""
    kind = problem["type"]
    key = _dotted(location)
    context = problem.get("ctx", {})
    if kind == "extra_forbidden":
        return f"{key}: unknown key; {_nearest_key(location)}"
    if kind == "missing":
        return f"{key}: {_missing(location, data)}"
    if kind == "value_error":
        # The schema's own sentence names the keys that it compares.
        reason = str(context["error"])
        return f"{key}: {reason}" if key else reason
    if kind == "tuple_type" and find_section(location) and isinstance(_value_at(data, location), Mapping):
        return f"{key}: one section is given, a list of them expected: [[{key}]], or [{{...}}] in Python"
    # pydantic quotes words like Python, TOML like this.
    expected = EXPECTED.get(kind, problem["msg"]).format_map(context).replace("'", '"')
    return f"{key} = {_shown(_value_at(data, location))}: expected {expected}"


def _missing(location: Location, data: Mapping[str, Any]) -> str:
    """What is said of a key, a section or an item of a list that is missing."""
    if isinstance(location[-1], int):
        return f"the list is too short: {_shown(_value_at(data, location[:-1]))}"
    # Further in, what takes a section takes a list as well.
    kind = "section" if len(location) == 1 and find_section(location) is not None else "key"
    return f"this {kind} is missing; it has no default"


def _nearest_key(location: Location) -> str:
    """What to do about an unknown key."""
    key, section = str(location[-1]), find_section(location[:-1])
    if section is None:
        return "leave it out"
    homes = [f"[{_dotted(home)}]" for home, other in list_sections() if key in other.model_fields]
    if homes:
        return f"it belongs to {' or '.join(homes)}"
    return describe_nearest(key, list(section.model_fields))


def _value_at(data: Any, location: Location) -> Any:
    """The value that the case file gives at a location."""
    for step in location:
        data = data[step]
    return data


def _dotted(location: Location) -> str:
    """Write a location as in TOML, with the place in a list in brackets, counted from 0."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in location)
    return text.removeprefix(".")


def _shown(value: Any) -> str:
    """Write a value as in TOML, shortened."""
    if isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, str):
        text = '"' + value.replace("\n", "\\n") + '"'
    elif isinstance(value, Mapping):
        text = "{" + ", ".join(f"{key} = {_shown(item)}" for key, item in value.items()) + "}"
    elif isinstance(value, Sequence):
        text = "[" + ", ".join(_shown(item) for item in value) + "]"
    else:
        text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."


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
        """Keep the mesh of a case, pixels, and how near fields' own meshes are tied in it, in place of any other."""
        self._case, self._built = case, (mesh, tying)

    def take(self, case: Case) -> tuple[Mesh, Tying | None] | None:
        """Give away the mesh of a case, as ``build_meshes`` would build it; None where that of this one is not kept."""
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

    def __repr__(self) -> str:
        return f"<ddic.LoadedCase {self.path}>"

    @property
    def is_series(self) -> bool:
        """Whether it names several deformed images."""
        return is_series(self.case)

    def require_images(self, what: str, remedy: str) -> None:
        """Raise InputError of a case of volumes; ``what`` knows images alone."""
        if self.case.dim == 3:
            raise InputError(f"{self.path}: [volumes]: {what} knows images; {remedy}")

    def list_inputs(self) -> list[Path]:
        """List the files that it reads and no run replaces, the case file too."""
        return [self.path, *list_named_files(self.case, self.path.parent)]

    def with_output(self, file: Path) -> LoadedCase:
        """Have the result written elsewhere: the same but for ``output.file``."""
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
    return load_case_text(read_text(path, "case file", "check the path"), path)


def load_case_text(text: str, path: Path) -> LoadedCase:
    """Read a case from the text of its file, or of what the file is to be, as ``load_case`` does from the file."""
    place = path.resolve()
    _require_text_name(place)
    case = _absolute(parse_case_text(text, path), place.parent)
    return LoadedCase(find_frames(case, path), place, text)


def load_case_leniently(path: Path | str) -> tuple[LoadedCase | None, list[str]]:
    """Read a case file as far as it can be read, so that what else is wrong can be told beside its bad keys.

    The case comes without its bad keys, not to be run where there are any, or as None where it makes no sense without
    them; and the problems of the keys, one line each.
    """
    try:
        path = as_path(path, "case file")
        text = read_text(path, "case file", "check the path")
    except InputError as error:
        return None, list(error.problems)
    return load_text_leniently(text, path)


def load_text_leniently(text: str, path: Path) -> tuple[LoadedCase | None, list[str]]:
    """Read a case from the text of its file as far as it can be read, as ``load_case_leniently`` does from the file."""
    try:
        return load_case_text(text, path), []
    except InputError as error:
        problems = list(error.problems)
    try:
        _require_text_name(path.resolve())
        data = convert_shorthand(parse_toml(text, path))
    except InputError:
        return None, problems
    folder = path.resolve().parent
    missing = [f"{file}: no such file; check the path" for file in list_named_files(data, folder)
               if not any(map(is_readable_file, list_parts(file))) and not is_pattern(file)]
    case = _validate_without_bad_keys(data)
    if case is None:
        # Little else can be said of it.
        return None, [*problems, *missing]
    try:
        return LoadedCase(find_frames(_absolute(case, folder), path), path.resolve(), text), problems
    except InputError as error:
        return None, [*problems, *(line for line in error.problems if line not in problems)]


def _validate_without_bad_keys(data: dict[str, Any]) -> Case | None:
    """The case that is left without what is wrong; what one bad key hides may be wrong too."""
    for _ in range(MOST_REPAIRS):
        try:
            return _validate(data)
        except ValidationError as error:
            locations = [problem["loc"] for problem in error.errors() if problem["type"] != "missing"]
        if not locations:
            return None
        for location in [_remove_kinds(location, data) for location in locations]:
            _remove(data, location)
    return None


def _require_text_name(path: Path) -> None:
    """Refuse a case in a folder whose name is no text, which results and messages could not hold."""
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError as error:
        name = str(path).encode("utf-8", "backslashreplace").decode()
        raise InputError(f"{name}: the path of this case file is no UTF-8 text, which results name; rename the folder "
                         "or the file") from error


def _remove(data: Any, location: Location) -> None:
    """Remove a key; what a list holds goes with the whole list, whose places would else change their meaning."""
    keys = location[:next((k for k, step in enumerate(location) if isinstance(step, int)), len(location))]
    for step in keys[:-1]:
        # What one problem has removed, the next one may lie in.
        data = data.get(step, {})
    if keys:
        data.pop(keys[-1], None)


def parse_case_text(text: str, path: Path) -> Case:
    """Validate the TOML text of a case file, ``path`` in messages; paths stay. Raises InputError as ``load_case``."""
    return convert_to_case(convert_shorthand(parse_toml(text, path)), str(path))


def convert_to_case(data: Mapping[str, Any], source: str) -> Case:
    """Validate what a case says, its shorthand written out; InputError has a line for each fault, after ``source``."""
    word = data.get("discontinuity")
    if isinstance(word, str):
        raise InputError(f'{source}: discontinuity = "{word}": write "{DETECT}", or [[discontinuity]] sections')
    try:
        return _validate(data)
    except ValidationError as error:
        raise InputError([f"{source}: {line}" for line in describe(error, data)]) from error


def _validate(data: Mapping[str, Any]) -> Case:
    # Only pydantic's JSON mode is strict about types ("8" is not 8) and yet takes lists for tuples.
    return Case.model_validate_json(json.dumps(data, default=_no_json_type), strict=True)


def convert_shorthand(data: Mapping[str, Any]) -> dict[str, Any]:
    """Write out the shorthand of a case, not validated: a section without vertices for ``discontinuity = "detect"``."""
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
        return find_real_path(folder / value)
    if isinstance(value, BaseModel):
        return _absolute(value, folder)
    if isinstance(value, tuple):
        return tuple(_absolute_value(item, folder) for item in value)
    return value


OF_DUAL = ("weighting", "preconditioner", "recycle", "local_inverse")
"""Keys of [solver] that only the interface problem asks."""

OF_KRYLOV = ("tolerance", "max_iterations", "inexact")
"""Keys of [solver] that only iterative linear steps ask."""

OF_PARTITION = ("subdomains", "partition", "blocks", "partition_file")
"""Keys of [solver] that say how the mesh is split."""

OF_SEARCH = ("rigid", "features", "pyramid", "largest_enriched_block")
"""Keys of [start] that only a search asks."""


def list_unused_keys(case: Case) -> list[str]:
    """List the keys that a valid case gives and nothing asks for, a line each: key, what it goes with, what to do."""
    method, start = case.solver.method, case.start
    searches = start.from_result is None
    is_never_dual = method not in ("auto", "dual")
    # Section, keys of it, what they go with, and whether that is missing.
    rules: list[tuple[str, tuple[str, ...], str, bool]] = [
        ("solver", ("frames",), 'solver.method = "auto"', method != "auto"),
        ("solver", OF_DUAL, 'solver.method = "dual"', is_never_dual),
        ("solver", OF_KRYLOV, 'solver.method = "dual", "conjugate_gradient" or "matching"',
         method in ("assembled", "monolithic")),
        ("solver", OF_PARTITION, "a method of several subdomains", method == "monolithic"),
        ("start", OF_SEARCH, "a start without start.from_result, which replaces it", not searches),
        ("start", ("features",), "start.rigid = true, after which they are sought",
         searches and start.features and not start.rigid),
        ("start", ("largest_enriched_block",), "[[discontinuity]]", searches and not case.discontinuity),
        ("start", ("independent",), 'solver.method = "dual"', is_never_dual and start.independent),
        ("output", ("independent_fields",), 'solver.method = "dual" and start.independent = true',
         case.output.independent_fields and not (method == "dual" and start.independent)),
        (case.imaging_name, ("noise",), "output.uncertainty = true, or [[near]], whose cameras it is weighed against",
         not (case.near or case.output.uncertainty)),
    ]
    return [f"{name}.{key} changes nothing here: it goes with {partner}; leave it out"
            for name, keys, partner, is_idle in rules if is_idle
            for key in keys if key in getattr(case, name).model_fields_set]

"""What is wrong with a case file, in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from ddic.case.schema import Case

Location = tuple[int | str, ...]

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
    "greater_than": "more than {gt:g}",
    "greater_than_equal": "at least {ge:g}",
    "less_than": "less than {lt:g}",
    "less_than_equal": "at most {le:g}",
    "too_short": "at least {min_length} items",
    "too_long": "at most {max_length} items",
}
"""What a key takes, by the kind of pydantic's error."""


def describe(error: ValidationError, data: Mapping[str, Any]) -> list[str]:
    """One line per problem: key, value given, what is expected; data: the parsed case file."""
    return [_line(problem, data) for problem in error.errors(include_url=False)]


def _line(problem: ErrorDetails, data: Mapping[str, Any]) -> str:
    location, kind = problem["loc"], problem["type"]
    key, context = _dotted(location), problem.get("ctx", {})
    if kind == "extra_forbidden":
        return f"{key}: unknown key; {_nearest_key(location)}"
    if kind == "missing":
        return f"{key}: {_missing(location, data)}"
    if kind == "value_error":
        # The schema's own sentence names the keys that it compares.
        reason = str(context["error"])
        return f"{key}: {reason}" if key else reason
    # pydantic quotes words like Python, TOML like this.
    expected = EXPECTED.get(kind, problem["msg"]).format_map(context).replace("'", '"')
    return f"{key} = {_shown(_value_at(data, location))}: expected {expected}"


def _missing(location: Location, data: Mapping[str, Any]) -> str:
    if isinstance(location[-1], int):
        return f"the list is too short: {_shown(_value_at(data, location[:-1]))}"
    kind = "section" if _is_section(location) else "key"
    return f"this {kind} is missing; it has no default"


def _nearest_key(location: Location) -> str:
    key, section = str(location[-1]), _section(location[:-1])
    if section is None:
        return "leave it out"
    near = get_close_matches(key.lower(), list(section.model_fields), n=1)
    if near:
        return f'did you mean "{near[0]}"?'
    home = _home_of(key)
    if home:
        return f"it belongs to {home}"
    return "valid here: " + ", ".join(section.model_fields)


def _home_of(key: str) -> str:
    """The sections of the first level that have such a key."""
    names = [name for name in Case.model_fields
             if (section := _section((name,))) is not None and key in section.model_fields]
    return " or ".join(f"[{name}]" for name in names)


def _section(location: Location) -> type[BaseModel] | None:
    """The schema's section at a location, or None where there is none."""
    section: type[BaseModel] = Case
    for step in location:
        if isinstance(step, int):
            continue
        field = section.model_fields.get(step)
        inner = None if field is None else _model_in(field.annotation)
        if inner is None:
            return None
        section = inner
    return section


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The section inside an annotation such as ``tuple[Circle, ...]`` or ``Section | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for part in get_args(annotation) if (found := _model_in(part))), None)


def _is_section(location: Location) -> bool:
    return _section(location) is not None


def _value_at(data: Any, location: Location) -> Any:
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
        text = f'"{value}"'
    elif isinstance(value, Mapping):
        text = "{" + ", ".join(f"{key} = {_shown(item)}" for key, item in value.items()) + "}"
    elif isinstance(value, Sequence):
        text = "[" + ", ".join(_shown(item) for item in value) + "]"
    else:
        text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."

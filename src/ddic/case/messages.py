"""What is wrong with a case file, in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from ddic.case.schema import Case
from ddic.case.sections import Location, find_section

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

TOO_SHORT = "too_short"
"""What pydantic calls a list of too few items."""

KINDS = ("one", "several")
"""What the schema calls the two kinds of values that a key may take, which no key is called."""


def describe(error: ValidationError, data: Mapping[str, Any]) -> list[str]:
    """Say what is wrong with a case file: key, value given, what is expected.

    Parameters
    ----------
    error : ValidationError
        What pydantic found.
    data : dict
        The parsed case file.

    Returns
    -------
    list of str
        A line per problem.
    """
    located = [(remove_kinds(problem["loc"], data), problem) for problem in error.errors(include_url=False)]
    return [_line(location, problem, data) for location, problem in located
            if problem["type"] != TOO_SHORT or _is_too_short(_value_at(data, location), problem)]


def _is_too_short(value: Any, problem: ErrorDetails) -> bool:
    """Whether a list has too few items itself, and not only without the wrong ones, which are told one by one."""
    return isinstance(value, list) and len(value) < problem["ctx"]["min_length"]


def remove_kinds(location: Location, data: Any) -> Location:
    """Remove from a location what pydantic says of the kind that a value was taken for.

    Parameters
    ----------
    location : tuple of str or int
        Where pydantic found a problem.
    data : dict
        The parsed case file.

    Returns
    -------
    tuple of str or int
        Keys and places that lead to a value of the case file, or to one that is missing.
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
    # pydantic quotes words like Python, TOML like this.
    expected = EXPECTED.get(kind, problem["msg"]).format_map(context).replace("'", '"')
    return f"{key} = {_shown(_value_at(data, location))}: expected {expected}"


def _missing(location: Location, data: Mapping[str, Any]) -> str:
    """What is said of a key, a section or an item of a list that is missing."""
    if isinstance(location[-1], int):
        return f"the list is too short: {_shown(_value_at(data, location[:-1]))}"
    kind = "section" if find_section(location) is not None else "key"
    return f"this {kind} is missing; it has no default"


def _nearest_key(location: Location) -> str:
    """What to do about an unknown key."""
    key, section = str(location[-1]), find_section(location[:-1])
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
    names = []
    for name in Case.model_fields:
        section = find_section((name,))
        if section is not None and key in section.model_fields:
            names.append(f"[{name}]")
    return " or ".join(names)


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
        text = f'"{value}"'
    elif isinstance(value, Mapping):
        text = "{" + ", ".join(f"{key} = {_shown(item)}" for key, item in value.items()) + "}"
    elif isinstance(value, Sequence):
        text = "[" + ", ".join(_shown(item) for item in value) + "]"
    else:
        text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."

"""Sections of the schema by their place in a case file."""

from __future__ import annotations

from typing import Any, get_args

from pydantic import BaseModel

from ddic.case.schema import Case

Location = tuple[int | str, ...]
"""Keys and places in lists that lead to a value of a case file, from outside in."""


def find_section(location: Location) -> type[BaseModel] | None:
    """Find the schema of a section.

    Parameters
    ----------
    location : tuple of str and int
        Keys that lead to it; places in lists are passed over.

    Returns
    -------
    type or None
        Its model; None where there is no section at that place.
    """
    section: type[BaseModel] = Case
    for step in location:
        if isinstance(step, int):
            continue
        field = section.model_fields.get(step)
        inner = None if field is None else find_section_in(field.annotation)
        if inner is None:
            return None
        section = inner
    return section


def find_section_in(annotation: Any) -> type[BaseModel] | None:
    """Find the section inside an annotation such as ``tuple[Circle, ...]`` or ``Section | None``.

    Parameters
    ----------
    annotation : type
        Of a key.

    Returns
    -------
    type or None
        The first model that it names; None where it names none.
    """
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for part in get_args(annotation):
        found = find_section_in(part)
        if found is not None:
            return found
    return None

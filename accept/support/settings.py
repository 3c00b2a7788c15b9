"""Settings of cases that are not the default, as rows print them."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from typing import Any

MONOLITHIC: Mapping[str, Any] = {"solver": {"method": "monolithic"}}
"""One operator, factorised at once: for checks on one rank that are about something else than the linear step."""

INPUTS = frozenset({"images", "near", "mesh", "output"})
"""Sections of a case file that a row describes in its own words."""


def describe_settings(case: Mapping[str, Any] | str) -> str:
    """Tell the settings of a case in the words of its file."""
    sections = tomllib.loads(case) if isinstance(case, str) else case
    return ", ".join(f"{section}.{key} = {json.dumps(value)}" for section, keys in sections.items()
                     if isinstance(keys, Mapping) and section not in INPUTS for key, value in keys.items())

"""Kinds of bad input for every key of the schema of case files, found from the schema itself."""

from __future__ import annotations

import types
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from accept.trials.good_case import NEAR, OF_SECTION, PAIR
from accept.trials.path_edits import BAD_PATHS
from accept.trials.trial import Keys, Raw, Trial, change
from ddic.case.schema import Case, find_section_in

NUMBERS: Mapping[str, Any] = {
    "negative": -1, "zero": 0, "nan": Raw("nan"), "infinite": Raw("inf"), "huge": Raw("1e308"), "tiny": Raw("1e-300"),
    "2^31": 2**31, "2^63": 2**63, "5000 digits": Raw("9" * 5000),
}
NO_NUMBERS: Mapping[str, Any] = {"text": "many", "true": True, "list": [], "table": {}, "date": Raw("1979-05-27")}
NO_TEXTS: Mapping[str, Any] = {"number": 3, "true": True, "list": [], "table": {}, "date": Raw("1979-05-27")}
TEXTS: Mapping[str, Any] = {"empty": "", "NUL": "a\0b", "long": "a" * 100_000, "lines": "one\ntwo",
                            "unpaired surrogate": Raw('"\\ud800"')}
NO_FLAGS: Mapping[str, Any] = {"text": "true", "number": 1, "list": [], "table": {}}
LISTS: Mapping[str, Any] = {
    "empty": [], "of nan": Raw("[nan, nan, nan, nan]"), "of texts": ["a", "b"], "too long": [1.0] * 50,
    "of lists": [[[[1.0]]]], "negative": [-5.0, -6.0, -7.0, -8.0], "huge": Raw("[1e308, 1e308, 1e308, 1e308]"),
    "infinite": Raw("[inf, inf]"), "2^63": [2**63, 2**63], "huge cells": [[1e308, 1e308], [-1e308, 1e308], [0, 1]],
    "one place": [[1.0, 1.0], [1.0, 1.0], [1.0, 1.0]],
}
NO_LISTS: Mapping[str, Any] = {"text": "many", "number": 3, "true": True, "table": {},
                               "nested": Raw("[" * 3000 + "]" * 3000)}
OF_LIST = 200
"""Most lines on a list: one for each entry that is wrong."""

NO_SECTIONS: Mapping[str, Any] = {"text": "many", "number": 3, "list of numbers": [1, 2], "true": True}

BESIDE: Mapping[Keys, Mapping[str, Any]] = {
    ("solver", "blocks"): {"solver": {"partition": "blocks"}},
    ("solver", "partition_file"): {"solver": {"method": "dual", "partition": "file"}},
    ("regularization", "eta"): {"regularization": {}},
    ("images", "pixel_size"): {"images": {**PAIR["images"], "length_unit": "mm"}},
    ("images", "length_unit"): {"images": {**PAIR["images"], "pixel_size": 0.1}},
    ("images", "saturation"): {"images": {**PAIR["images"], "exclude_saturated": True}},
    ("mesh", "file"): {"mesh": {}},
    ("mesh", "mapping"): {"mesh": {"file": "mesh.msh"}},
    ("start", "frame"): {"start": {"from_result": "earlier.series.vtkhdf"}},
    ("near", "ratio"): {"near": [{"reference": "near_reference.tif", "deformed": "near_deformed.tif",
                                  "offset": [0, 0]}]},
    ("near", "offset"): {"near": [{"reference": "near_reference.tif", "deformed": "near_deformed.tif", "ratio": 3}]},
}
"""What a key needs beside it, or replaces; a key that is not here is tried in its section's good case as it is."""


def list_schema_trials() -> list[Trial]:
    """List wrong types, impossible values and misspellings of every key and section.

    Returns
    -------
    list of Trial
        In the order of the schema.
    """
    return list(_of_section(Case, ()))


def _of_section(section: type[BaseModel], above: Keys) -> Iterator[Trial]:
    for name, field in section.model_fields.items():
        keys = (*above, name)
        inner = find_section_in(field.annotation)
        if inner is not None and len(keys) < 4:
            yield from (replace(trial, n_mistakes=OF_LIST) for trial in _of_values(keys, NO_SECTIONS, "refused"))
            yield from _of_values((*keys, "nonsense"), {"unknown key": 1}, "refused")
            # A near field's own mesh is described as the mesh is.
            if keys != ("near", "mesh"):
                yield from _of_section(inner, keys)
        else:
            yield from _of_key(keys, field.annotation)


def _of_key(keys: Keys, annotation: Any) -> Iterator[Trial]:
    yield _trial((*keys[:-1], f"{keys[-1]}s"), "neighbour's spelling", 1, "refused")
    kinds = set(_list_kinds(annotation))
    if Path in kinds:
        yield from _of_path(keys)
    elif tuple in kinds:
        yield from (replace(trial, n_mistakes=OF_LIST) for trial in _of_values(keys, LISTS))
        yield from _of_values(keys, {} if kinds & {int, float} else NO_LISTS, "refused")
    elif Literal in kinds:
        yield from _of_choices(keys, annotation)
    elif bool in kinds:
        yield from _of_values(keys, NO_FLAGS, "refused")
    elif kinds & {int, float}:
        yield from _of_values(keys, NUMBERS)
        yield from _of_values(keys, NO_NUMBERS, "refused")
        yield from _of_values(keys, {"half": 0.5} if int in kinds else {}, "refused")
    else:
        yield from _of_values(keys, TEXTS)
        yield from _of_values(keys, NO_TEXTS, "refused")


def _list_kinds(annotation: Any) -> Iterator[Any]:
    """What an annotation takes at its top: types, tuple for lists, Literal for choices."""
    origin = get_origin(annotation)
    if origin is None:
        yield annotation
    elif origin in (Union, types.UnionType):
        for part in get_args(annotation):
            yield from _list_kinds(part)
    elif hasattr(annotation, "__metadata__"):
        yield from _list_kinds(get_args(annotation)[0])
    else:
        yield origin


def _of_choices(keys: Keys, annotation: Any) -> Iterator[Trial]:
    for choice in get_args(annotation):
        if isinstance(choice, str):
            wrong = {f"{choice} mistyped": choice[:-1] + "~", f"{choice} in capitals": choice.swapcase()}
            yield from _of_values(keys, wrong, "refused")
    yield from _of_values(keys, {"empty": "", "list": [], "number": 7, "table": {}}, "refused")


def _of_path(keys: Keys) -> Iterator[Trial]:
    yield from _of_values(keys, NO_TEXTS)
    for name, bad in BAD_PATHS.items():
        is_output = keys[0] == "output"
        if is_output and not bad.for_output:
            continue
        # Where it can be read, it may be a picture of something else.
        trial = _trial(keys, name, bad.path, "refused" if bad.is_refused else "may fail")
        yield replace(trial, edits=bad.edits)


def _of_values(keys: Keys, values: Mapping[str, Any], expected: Any = "refused or measured") -> Iterator[Trial]:
    for name, value in values.items():
        yield _trial(keys, name, value, expected)


def _trial(keys: Keys, name: str, value: Any, expected: Any) -> Trial:
    case = OF_SECTION.get(keys[0], PAIR)
    if keys[:2] == ("near", "mapping_file"):
        case = NEAR
    beside = next((more for place, more in BESIDE.items() if keys[:len(place)] == place), {})
    for section, more in beside.items():
        merged = {**case.get(section, {}), **more} if section == "solver" and isinstance(more, dict) else more
        case = {**case, section: merged}
    if "blocks" in keys or "partition_file" in keys:
        case = change(case, ("solver",), {k: v for k, v in case["solver"].items() if k != "subdomains"})
    return Trial(f"{'.'.join(keys)}: {name}", change(case, keys, value), expected=expected)

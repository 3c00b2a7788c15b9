"""Kinds of bad input for every key of a case, found from the schema, and of bad command lines for every command.

And what a path in a case may lead to, and how the folder is changed so that it does.
"""

from __future__ import annotations

import os
import types
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

import click
from pydantic import BaseModel

from accept.inputs_and_outputs import FULL, NULL, make_device
from accept.trials.trial import CASE_FILE, NEAR, OF_SECTION, PAIR, REGULARIZED, VOLUME, Edit, Keys, Raw, Trial, change
from ddic.case.schema import Case, find_section_in
from ddic.cli.app import COMMANDS, command_line

NAME = "odd"


@dataclass(frozen=True)
class BadPath:
    """A path.

    Attributes
    ----------
    path : str or Raw
        As the case names it.
    edits : tuple of Edit
        What is made in the folder.
    is_refused : bool
        Whether no input can be read there.
    for_output : bool
        Whether an output cannot be written there either.
    """

    path: str | Raw
    edits: tuple[Edit, ...] = ()
    is_refused: bool = True
    for_output: bool = True


def _make_folder(folder: Path) -> None:
    (folder / NAME).mkdir()


def _make_empty(folder: Path) -> None:
    (folder / NAME).touch()


def _make_loop(folder: Path) -> None:
    (folder / NAME).symlink_to(NAME)


def _make_dangling(folder: Path) -> None:
    (folder / NAME).symlink_to("nowhere/at/all")


def _make_pipe(folder: Path) -> None:
    os.mkfifo(folder / NAME)


def make_own_device(folder: Path, number: int = NULL) -> None:
    """Make a device of the trial's own."""
    make_device(folder / NAME, number)


def _make_text(folder: Path) -> None:
    (folder / NAME).write_text("nothing of the kind\n", encoding="utf-8")


def _make_unreadable(folder: Path) -> None:
    (folder / NAME).write_bytes((folder / "reference.tif").read_bytes())
    (folder / NAME).chmod(0)


BAD_PATHS: Mapping[str, BadPath] = {
    "missing": BadPath("missing/odd.vtkhdf"),
    "a folder": BadPath(NAME, (_make_folder,)),
    "the case's folder": BadPath("."),
    "no name": BadPath(""),
    "an empty file": BadPath(NAME, (_make_empty,), for_output=False),
    "text": BadPath(NAME, (_make_text,), for_output=False),
    # Who may do everything reads it all the same.
    "unreadable": BadPath(NAME, (_make_unreadable,), is_refused=False, for_output=False),
    "NUL": BadPath("a\0b"),
    "too long a name": BadPath("a" * 300),
    "too long a path": BadPath("a/" * 2100),
    "a loop of links": BadPath(NAME, (_make_loop,)),
    "a link to nothing": BadPath(NAME, (_make_dangling,)),
    "a pipe": BadPath(NAME, (_make_pipe,)),
    "a device": BadPath(NAME, (make_own_device,)),
    "a device that is full": BadPath(NAME, (partial(make_own_device, number=FULL),)),
    "in /proc": BadPath("/proc/odd.vtkhdf"),
    "a pattern of nothing": BadPath("none_*.tif", for_output=False),
    "the case file itself": BadPath("case.toml"),
}
"""By what there is."""


GOOD: Mapping[str, tuple[str, ...]] = {
    "run": (CASE_FILE,), "check": (CASE_FILE,), "mesh": (CASE_FILE, "--output", "made.vtu"),
    "uncertainty": (CASE_FILE, "--sizes", "16", "--displacements", "2"),
    "sweep": (CASE_FILE, "--lengths", "0", "--elements", "16"), "info": ("earlier.pair.vtkhdf",),
    "plot": ("earlier.pair.vtkhdf", "--kind", "partition"), "probe": ("earlier.pair.vtkhdf", "--point", "40,40"),
    "export": ("earlier.pair.vtkhdf",), "report": ("earlier.pair.vtkhdf",), "opening": ("earlier.cut.vtkhdf",),
    "crack": ("earlier.cut.vtkhdf",), "calibrate": ("far_reference.tif", "near_reference.tif", "--ratio", "3"),
    "synth": ("translation", "--size", "32x32", "--output", "made"),
}
"""Arguments with which a command succeeds; a command that is not here is tried without any."""

BAD_WORDS = ("", "nan", "-inf", "1e308", "-1", "0", "2x", "a\tb", "9" * 5000, "a" * 300, "10x" + "9" * 20)
BAD_FILES = ("missing.odd", ".", "mask.png", "points.csv", CASE_FILE, "earlier.pair.residual.vtkhdf", NAME, "")
NO_UTF8 = "\udcff"
"""A byte that is no UTF-8, as Python has it among a command's arguments."""


def list_command_trials(good: Mapping[str, tuple[str, ...]] | None = None) -> list[Trial]:
    """List bad values of every option, and bad, missing and spare arguments, of every command, or of some.

    ``good`` are their arguments with which they succeed; by default those of all commands.
    """
    if good is not None:
        return [trial for name, words in good.items() for trial in _of_command(name, words)]
    trials = [trial for name in COMMANDS for trial in _of_command(name, GOOD.get(name, ()))]
    unknown = [_command_trial((word,)) for word in ("nonsense", "--nonsense", "ru")]
    return [*trials, _command_trial((), "ends"), *unknown]


def _of_command(name: str, good: tuple[str, ...]) -> Iterator[Trial]:
    command = command_line.get_command(click.Context(command_line), name)
    assert command is not None
    if isinstance(command, click.Group):
        yield from (_command_trial((name, inner), "ends") for inner in (*command.commands, "nonsense"))
        command = command.commands[good[0]]
    yield _command_trial((name,), "ends" if name == "synth" else "refused")
    yield _command_trial((name, *good, "one", "more", "words"))
    yield _command_trial((name, *good, "--nonsense"))
    if good and good[0] != "translation":
        files = (*BAD_FILES, NO_UTF8, "a" * 300)
        yield from (_command_trial((name, file, *good[1:]), "refused or measured") for file in files)
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            yield from _of_option(name, good, parameter)


def _of_option(name: str, good: tuple[str, ...], option: click.Option) -> Iterator[Trial]:
    spelt = option.opts[0]
    if spelt == "--help" or option.is_flag:
        return
    # An option of which the value may be left out says what it means then.
    may_stand_alone = isinstance(option.flag_value, (int, float, str)) and option.flag_value is not False
    yield _command_trial((name, *good, spelt), "refused or measured" if may_stand_alone else "refused")
    yield _command_trial((name, *good, f"{spelt}s", "1"))
    is_path = isinstance(option.type, click.Path)
    for word in BAD_FILES if is_path else BAD_WORDS:
        values = (word,) * max(1, option.nargs)
        yield _command_trial((name, *good, spelt, *values), "refused or measured")


def _command_trial(arguments: tuple[str, ...], expected: str = "refused") -> Trial:
    shown = " ".join(word if len(word) < 40 else f"{word[:10]}...{len(word)}" for word in arguments)
    edits = (make_own_device,) if NAME in arguments else ()
    return Trial(f"ddic {shown!a}", PAIR, edits, commands=(arguments,), expected=expected)  # type: ignore[arg-type]


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

CIRCLE: Mapping[str, Any] = {"center": [48, 48], "radius": 30}
REGIONS: Mapping[Keys, Any] = {("region", "center"): CIRCLE, ("region", "radius"): CIRCLE,
                               ("region",): {"vertices": [[20, 20], [70, 25], [50, 70]]},
                               (): PAIR["mesh"]["structured"]["region"]}
"""A good region beside its keys, those of a polygon beside all others."""

BESIDE: Mapping[Keys, Mapping[str, Any]] = {
    ("solver", "blocks"): {"solver": {"partition": "blocks"}},
    ("solver", "partition_file"): {"solver": {"method": "dual", "partition": "file"}},
    ("regularization", "eta"): {"regularization": {}},
    ("regularization", "hardening_ratio"): {"regularization": {**REGULARIZED["regularization"], "yield_strain": 0.01}},
    ("regularization", "stiffness"): {
        "region": [{"name": "left", "shape": [0, 0, 48, 96]}],
        "regularization": {**REGULARIZED["regularization"], "stiffness": [{"region": "left", "ratio": 2.0}]}},
    ("images", "pixel_size"): {"images": {**PAIR["images"], "length_unit": "mm"}},
    ("images", "length_unit"): {"images": {**PAIR["images"], "pixel_size": 0.1}},
    ("volumes", "voxel_size"): {"volumes": {**VOLUME["volumes"], "length_unit": "mm"}},
    ("volumes", "length_unit"): {"volumes": {**VOLUME["volumes"], "voxel_size": 0.1}},
    ("images", "saturation"): {"images": {**PAIR["images"], "exclude_saturated": True}},
    ("mesh", "file"): {"mesh": {}},
    **{("mesh", kind, *keys): {"mesh": {kind: {"region": region, "element_size": 16}}}
       for kind in ("structured", "unstructured") for keys, region in REGIONS.items()},
    **{("region", "shape", *keys[1:]): {"region": [{"name": "left", "shape": shape}]}
       for keys, shape in REGIONS.items() if keys},
    ("mesh", "mapping"): {"mesh": {"file": "mesh.msh"}},
    ("start", "frame"): {"start": {"from_result": "earlier.series.vtkhdf"}},
    ("near", "ratio"): {"near": [{"reference": "near_reference.tif", "deformed": "near_deformed.tif",
                                  "offset": [0, 0]}]},
    ("near", "offset"): {"near": [{"reference": "near_reference.tif", "deformed": "near_deformed.tif", "ratio": 3}]},
}
"""What a key needs beside it, or replaces; a key that is not here is tried in its section's good case as it is."""


def list_schema_trials() -> list[Trial]:
    """List wrong types, impossible values and misspellings of every key and section."""
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

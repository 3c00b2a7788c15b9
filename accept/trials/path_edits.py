"""What a path in a case may lead to, and how the folder is changed so that it does."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from accept.support.own_device import FULL, NULL, make_device
from accept.trials.trial import Edit, Raw

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
    """Make a device of the trial's own.

    Parameters
    ----------
    folder : Path
        Where, under NAME.
    number : int, optional
        Of the kind.
    """
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

"""What is tried: a small change to a good case, the commands that meet it, and what may come of it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

CASE_FILE = "case.toml"
ON_CASE: tuple[tuple[str, ...], ...] = (("check", CASE_FILE), ("run", CASE_FILE))

Keys = tuple[str, ...]
"""That lead to a value, from outside in."""

Edit = Callable[[Path], None]
"""Changes files in the folder of a good case."""

Expected = Literal["refused", "refused or measured", "may fail", "ends"]


@dataclass(frozen=True)
class Raw:
    """TOML text that stands for a value as it is written.

    Attributes
    ----------
    text : str
        Of the value, which need not be valid.
    """

    text: str


@dataclass(frozen=True)
class Trial:
    """One kind of input.

    Attributes
    ----------
    name : str
        What is changed, and to what.
    case : mapping
        The case file's sections; a ``Raw`` stands as it is.
    edits : tuple of Edit
        What is changed beside the case file.
    commands : tuple of tuple of str
        Arguments of ``ddic``, one command after the other.
    expected : str
        "refused": exit code 2; "refused or measured": 0 with a result where the input is legal after all; "may
        fail": 1 too, where it is legal and shows nothing that could be measured; "ends": no
        more than that the command ends in order, for damage that may leave a file whole.
    environment : mapping
        Variables of the environment that differ.
    n_mistakes : int
        Most lines that tell of them: each wrong entry of a list may have its own.
    """

    name: str
    case: Mapping[str, Any]
    edits: tuple[Edit, ...] = ()
    commands: tuple[tuple[str, ...], ...] = ON_CASE
    expected: Expected = "refused or measured"
    environment: Mapping[str, str] = field(default_factory=dict)
    n_mistakes: int = 1

    def write(self, folder: Path) -> None:
        """Write the case file and change what is beside it.

        Parameters
        ----------
        folder : Path
            A copy of the good case.
        """
        (folder / CASE_FILE).write_text(write_toml(self.case), encoding="utf-8", errors="surrogatepass")
        for edit in self.edits:
            edit(folder)


def write_toml(case: Mapping[str, Any]) -> str:
    """Write sections as TOML, one line each.

    Parameters
    ----------
    case : mapping
        Of values, mappings, lists and ``Raw`` texts.

    Returns
    -------
    str
        The text.
    """
    return "".join(f"{_write_key(key)} = {_write_value(value)}\n" for key, value in case.items())


def _write_key(key: str) -> str:
    return key if key.isidentifier() and key.isascii() else json.dumps(key)


def _write_value(value: Any) -> str:
    if isinstance(value, Raw):
        return value.text
    if isinstance(value, Mapping):
        inside = ", ".join(f"{_write_key(key)} = {_write_value(item)}" for key, item in value.items())
        return f"{{{inside}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_write_value, value))}]"
    if isinstance(value, str):
        return json.dumps(value).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value)


def change(case: Mapping[str, Any], keys: tuple[str, ...], value: Any) -> dict[str, Any]:
    """Give a case in which one key has another value.

    Parameters
    ----------
    case : mapping
        Sections.
    keys : tuple of str
        That lead to the value; the first entry of a list of sections is meant.
    value : object
        The new one.

    Returns
    -------
    dict
        A copy.
    """
    first, *rest = keys
    if not rest:
        return {**case, first: value}
    inner = case.get(first, {})
    if isinstance(inner, list):
        return {**case, first: [change(inner[0] if inner else {}, tuple(rest), value), *inner[1:]]}
    return {**case, first: change(inner, tuple(rest), value)}

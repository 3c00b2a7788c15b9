"""TOML files: their text, and values that can be used."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ddic.errors import InputError
from ddic.io.input_file import is_endless_file

DEEPEST = 50
"""Levels of lists and sections in one another: no file of ddic's has more than six. A larger value lets more nonsense
through to a check that says it less plainly."""

LARGEST = 2**63
"""Whole numbers of TOML have 64 bits."""


def read_text(path: Path, what: str, remedy: str) -> str:
    """Read a text file as UTF-8, with or without a byte-order mark.

    Parameters
    ----------
    path : Path
        The file.
    what : str
        What it should be, for the message.
    remedy : str
        What to do where it cannot be read.

    Returns
    -------
    str
        Without a byte-order mark.

    Raises
    ------
    InputError
        Where it cannot be read, is a pipe or a device, or is no UTF-8.
    """
    if is_endless_file(path):
        raise InputError(f"{path}: is no regular file, no {what}; {remedy}")
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text (byte {error.start}); save it as UTF-8") from error
    except (OSError, ValueError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise InputError(f"{path}: cannot read this {what} ({reason}); {remedy}") from error


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """Parse TOML and refuse values that no key can take.

    Parameters
    ----------
    text : str
        Of the file.
    path : Path
        Names the file in messages.

    Returns
    -------
    dict
        Its values.

    Raises
    ------
    InputError
        Where it is no TOML, holds numbers of more than 64 bits or NUL characters, or is nested beyond DEEPEST levels.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error
    except RecursionError as error:
        raise InputError(_describe_depth(path)) from error
    except ValueError as error:
        # Python refuses to convert such a number before TOML can.
        raise InputError(f"{path}: not valid TOML: a number of thousands of digits; write it as 1.5e3") from error
    try:
        problems = [f"{path}: {line}" for line in _list_unusable(data, "", 0)]
    except RecursionError as error:
        raise InputError(_describe_depth(path)) from error
    if problems:
        raise InputError(problems)
    return data


def _describe_depth(path: Path) -> str:
    return f"{path}: lists or sections lie in one another more than {DEEPEST} levels deep; no key takes that"


def _list_unusable(value: Any, key: str, depth: int) -> Iterator[str]:
    """What is wrong with values whatever their key, a line each."""
    if depth > DEEPEST:
        raise RecursionError
    if isinstance(value, dict):
        for name, inner in value.items():
            if "\0" in name:
                yield f"{name!r}: a key with a NUL character; write its name alone"
            yield from _list_unusable(inner, f"{key}.{name}" if key else name, depth + 1)
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from _list_unusable(inner, f"{key}[{number}]", depth + 1)
    elif isinstance(value, str) and "\0" in value:
        yield f"{key}: holds a NUL character (\\u0000), which ends a text for other programs; take it out"
    elif isinstance(value, int) and not -LARGEST <= value < LARGEST:
        # Python writes no more digits than some thousands.
        digits = str(value)[:20] if value.bit_length() < 1000 else hex(value)[:20]
        yield f"{key} = {digits}...: a whole number of more than 64 bits, which TOML does not have; give a smaller one"

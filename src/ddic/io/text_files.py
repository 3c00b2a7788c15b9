"""Text files: TOML, JSON, displacements at points from CSV, and partitions."""

import csv
import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.errors import InputError
from ddic.io.input_file import is_endless_file
from ddic.io.replace_on_exit import NewFiles, begin_files

DEEPEST = 50
"""Levels of lists and sections in one another: no file of ddic's has more than six. A larger value lets more nonsense
through to a check that says it less plainly."""

LARGEST = 2**63
"""Whole numbers of TOML have 64 bits."""


def read_text(path: Path, what: str, remedy: str) -> str:
    """Read a text file as UTF-8; a byte-order mark is left out.

    ``what`` it should be and the ``remedy`` where it cannot be read stand in the message. Raises InputError where it
    cannot be read, is a pipe or a device, or is no UTF-8.
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
    """Parse TOML and refuse values that no key can take; ``path`` names the file in messages.

    Raises InputError where it is no TOML, holds numbers of more than 64 bits or NUL characters, or is nested beyond
    DEEPEST levels.
    """
    try:
        data = tomllib.loads(text)
        problems = [f"{path}: {line}" for line in _list_unusable(data, "", 0)]
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}{_find_hint(text, str(error))}") from error
    except RecursionError as error:
        raise InputError(f"{path}: lists or sections lie in one another more than {DEEPEST} levels deep; no key takes "
                         "that") from error
    except ValueError as error:
        # Python refuses to convert such a number before TOML can.
        raise InputError(f"{path}: not valid TOML: a number of thousands of digits; write it as 1.5e3") from error
    if problems:
        raise InputError(problems)
    return data


def _find_hint(text: str, error: str) -> str:
    """What to do about the mistakes that everybody makes in the line that an error names; empty for others."""
    named = re.search(r"at line (\d+)", error)
    lines = text.splitlines()
    if named is None or int(named[1]) > len(lines):
        return ""
    line = lines[int(named[1]) - 1]
    if "\\" in line:
        return '; a backslash begins an escape in "...": write the path in \'...\', or with /'
    if re.search(r"=\s*[-+]?\d+,\d", line):
        return "; numbers have a decimal point, no comma"
    return ""


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


def write_json(path: Path, content: Mapping[str, Any], files: NewFiles | None = None) -> None:
    """Write a JSON file, under a temporary name that is then changed; numbers that are not finite become null.

    It takes its name with ``files``, by default by itself. Raises InputError where the folder cannot be written to.
    """
    text = json.dumps(convert_to_json(content), indent=2, allow_nan=False)
    with begin_files(files) as new:
        new.begin(path).write_text(text + "\n", encoding="utf-8")


def convert_to_json(value: Any) -> Any:
    """Make mappings, sequences, arrays, numbers and texts what JSON knows; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): convert_to_json(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [convert_to_json(item) for item in value]
    if hasattr(value, "tolist"):
        return convert_to_json(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


COLUMNS = {2: ("x", "y", "u", "v"), 3: ("x", "y", "z", "u", "v", "w")}
"""Columns that are read, of points in an image and in a volume; others may stand beside them."""

_SEPARATORS = ",;\t"


def read_point_table(path: Path, dim: int = 2) -> tuple[Array, IntArray]:
    """Read displacements at points, one at least, from a CSV file: COLUMNS, (n, 2 dim), and the row of each, from 1.

    A header row names the columns, in any order, then comes a row for each point; separated by commas, semicolons or
    tabs. Empty rows are passed over. Raises InputError where the file is missing or holds something else,
    with the row and the column.
    """
    text, columns = read_text(path, "table of points", "check the path"), COLUMNS[dim]
    lines = text.splitlines()
    separator = max(_SEPARATORS, key=lines[0].count) if lines else ","
    rows = [(number, row) for number, row in enumerate(csv.reader(lines, delimiter=separator), 1)
            if any(cell.strip() for cell in row)]
    if not rows:
        raise InputError(f"{path}: is empty; give a header row {','.join(columns)} and a row for each point")
    places = _find_columns(path, rows[0][1], columns)
    if len(rows) == 1:
        raise InputError(f"{path}: holds a header and no point; give a row {','.join(columns)} for each point, pixels")
    values = [_convert_row(path, number, row, dict(zip(columns, places, strict=True))) for number, row in rows[1:]]
    return np.array(values), np.array([number for number, _ in rows[1:]], dtype=np.int64)


def _find_columns(path: Path, header: Sequence[str], columns: Sequence[str]) -> list[int]:
    """Place of each column in a row."""
    names = [name.strip().lower() for name in header]
    for column in columns:
        if names.count(column) != 1:
            how = "no column" if column not in names else "more than one column"
            raise InputError(f'{path}: row 1: {how} "{column}" among {", ".join(header)}; name the columns '
                             f"{', '.join(columns)} in the first row")
    return [names.index(column) for column in columns]


def _convert_row(path: Path, number: int, row: Sequence[str], places: Mapping[str, int]) -> list[float]:
    values = []
    for name, place in places.items():
        if place >= len(row):
            raise InputError(f"{path}: row {number}: column {name} is missing; give {', '.join(places)} of each point")
        try:
            value = float(row[place])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InputError(f'{path}: row {number}, column {name}: "{row[place].strip()}" is no finite number; give '
                             "pixels, with a decimal point")
        values.append(value)
    return values


MOST_DIGITS = 18
"""Digits of a whole number of 64 bits."""


def read_partition(path: Path, n_cells: int) -> IntArray:
    """Read the subdomain of each cell, (n_cells,): one whole number per cell, from 0, without gaps.

    The numbers are separated by spaces or new lines; what follows a # is a comment. Raises InputError where the file
    cannot be read, has another length, or leaves a subdomain empty.
    """
    lines = read_text(path, "partition file", "check the path").splitlines()
    words = [word for line in lines for word in line.partition("#")[0].split()]
    bad = next((word for word in words if not (word.isascii() and word.isdecimal())), None)
    if bad is not None:
        raise InputError(f'{path}: "{bad}" is not a subdomain; give one whole number >= 0 per cell')
    if len(words) != n_cells:
        raise InputError(f"{path}: holds {len(words)} numbers, but the mesh has {n_cells} cells; "
                         "give one per cell, in the mesh's order")
    # As many subdomains as cells at most, none being empty: a larger number is a gap, however many digits it has.
    largest = max(words, key=lambda word: (len(word.lstrip("0")), word.lstrip("0")))
    if len(largest.lstrip("0")) > MOST_DIGITS or int(largest) >= n_cells:
        raise InputError(f"{path}: subdomain {largest[:MOST_DIGITS]}{'...' if len(largest) > MOST_DIGITS else ''}, but "
                         f"{n_cells} cells make {n_cells} subdomains at most; number them from 0 without gaps")
    parts = np.array([int(word) for word in words], dtype=np.int64)
    missing = np.setdiff1d(np.arange(parts.max() + 1), parts)
    if len(missing):
        raise InputError(f"{path}: subdomain {missing[0]} has no cell; number the subdomains without gaps")
    return parts

"""Values as JSON, which knows neither arrays nor numbers that are not finite."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ddic.io.replace_on_exit import NewFiles, begin_files


def write_json(path: Path, content: Mapping[str, Any], files: NewFiles | None = None) -> None:
    """Write a JSON file, under a temporary name that is then changed; numbers that are not finite become null.

    Parameters
    ----------
    path : Path
        The file.
    content : mapping
        By name.
    files : NewFiles, optional
        With which it takes its name; by default it does so by itself.

    Raises
    ------
    InputError
        Where the folder cannot be written to.
    """
    text = json.dumps(convert_to_json(content), indent=2, allow_nan=False)
    with begin_files(files) as new:
        new.begin(path).write_text(text + "\n", encoding="utf-8")


def convert_to_json(value: Any) -> Any:
    """Make a value of what JSON knows.

    Parameters
    ----------
    value : object
        Mappings, sequences, arrays, numbers, texts.

    Returns
    -------
    object
        Dictionaries, lists, numbers, texts; None for numbers that are not finite.
    """
    if isinstance(value, Mapping):
        return {str(key): convert_to_json(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [convert_to_json(item) for item in value]
    if hasattr(value, "tolist"):
        return convert_to_json(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

"""Files brought into the system's cache before they are needed."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Self

CHUNK = 1 << 22
"""Bytes read at a time. Larger ones keep the disk busier, smaller ones stop sooner."""


class ReadAhead:
    """Reads files in a thread of its own and drops what it reads; use it in a ``with`` statement."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="ddic-reader")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._thread.shutdown(wait=True, cancel_futures=True)

    def begin(self, paths: Iterable[Path]) -> None:
        """Begin to read files; one that cannot be read is told of by whoever needs it.

        Parameters
        ----------
        paths : iterable of Path
            Which.
        """
        for path in paths:
            self._thread.submit(_read, path)


def _read(path: Path) -> None:
    try:
        with path.open("rb", buffering=0) as file:
            while file.read(CHUNK):
                pass
    except OSError:
        return

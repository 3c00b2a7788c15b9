"""Files written while the program goes on, one after the other."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Self

from ddic.io.replace_on_exit import replaced_on_exit


class BackgroundWriter:
    """Writes files in a thread of its own; use it in a ``with`` statement, which waits for the last one."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="ddic-writer")
        self._pending: Future[None] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._thread.shutdown(wait=True)
        if error is None:
            self.wait()

    def write(self, path: Path, content: bytes) -> None:
        """Begin to write a file, once the last one is written.

        Parameters
        ----------
        path : Path
            Its name, taken when it is complete.
        content : bytes
            All of it.

        Raises
        ------
        OSError, InputError
            Where the last one could not be written.
        """
        self.wait()
        self._pending = self._thread.submit(_write, path, content)

    def wait(self) -> None:
        """Wait for what is being written.

        Raises
        ------
        OSError, InputError
            Where it could not be written.
        """
        pending, self._pending = self._pending, None
        if pending is not None:
            pending.result()


def _write(path: Path, content: bytes) -> None:
    with replaced_on_exit(path) as temporary:
        temporary.write_bytes(content)

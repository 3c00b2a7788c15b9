"""Problems of several checks gathered into one error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ddic.errors import InputError


class Problems:
    """Lines gathered from several checks, so that one failure does not hide the next.

    Attributes
    ----------
    lines : list of str
        One problem each.
    """

    def __init__(self) -> None:
        self.lines: list[str] = []

    @contextmanager
    def gathered(self, source: Path | None = None) -> Iterator[None]:
        """Keep the lines of an InputError that is raised inside.

        Parameters
        ----------
        source : Path, optional
            A file to name before each line.

        Yields
        ------
        None
            Nothing.
        """
        try:
            yield
        except InputError as error:
            self.add(error, source)

    def add(self, error: InputError, source: Path | None = None) -> None:
        """Keep the lines of an error.

        Parameters
        ----------
        error : InputError
            Of one check.
        source : Path, optional
            A file to name before each line.
        """
        prefix = "" if source is None else f"{source}: "
        self.lines += [prefix + line for line in error.problems]

    def require_none(self) -> None:
        """Raise all of them as one.

        Raises
        ------
        InputError
            Where there are any.
        """
        if self.lines:
            raise InputError(self.lines)

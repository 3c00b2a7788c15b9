"""Errors that ddic raises on purpose; each carries the exit code of the command line."""

import errno
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar


class DdicError(Exception):
    """A failure with a message written for the user; the command line exits with ``exit_code``."""

    exit_code = 1


class InputError(DdicError):
    """One or more problems in what the user gave (file, key, value and remedy, one line each).

    Parameters
    ----------
    problems : str or sequence of str
        One line each.
    """

    exit_code = 2

    def __init__(self, problems: str | Sequence[str]) -> None:
        self.problems = (problems,) if isinstance(problems, str) else tuple(problems)
        super().__init__("\n".join(self.problems))


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
        """Keep the lines of an InputError that is raised inside; ``source`` is a file to name before each line."""
        try:
            yield
        except InputError as error:
            prefix = "" if source is None else f"{source}: "
            self.lines += [prefix + line for line in error.problems]

    def require_none(self) -> None:
        """Raise all of them as one InputError, where there are any."""
        if self.lines:
            raise InputError(self.lines)


def describe_nearest(name: str, valid: Sequence[str]) -> str:
    """Describe what an unknown name may have been meant for: the nearest valid one, else all."""
    near = get_close_matches(name.lower(), valid, n=1)
    return f'did you mean "{near[0]}"?' if near else "valid here: " + ", ".join(valid)


def refuse_unknown_arguments(given: Iterable[str], valid: Sequence[str]) -> None:
    """Refuse arguments of other names than the valid ones, with an InputError that has a line for each."""
    unknown = [f"{name}: unknown argument; {describe_nearest(name, valid)}" for name in given if name not in valid]
    if unknown:
        raise InputError(unknown)


class ConvergenceError(DdicError):
    """An iteration (Krylov or Gauss-Newton) did not reach its tolerance.

    Parameters
    ----------
    message : str
        One line.
    last : object, optional
        What was found before.

    Attributes
    ----------
    last : object or None
        What was found before: a solver's solution, of which a method makes a measurement that did not converge. None
        where nothing was, or nothing can be shown.
    result : Result or None
        The same for who measures from Python: the last field, not converged, on every rank.
    """

    def __init__(self, message: str, last: Any = None) -> None:
        super().__init__(message)
        self.last = last
        self.result: Any = None


class StoppedError(ConvergenceError):
    """A run was asked by a signal to stop before it had converged."""

    exit_code = 3


class SingularSubdomainError(DdicError):
    """A local operator cannot be factorised, for instance for want of texture."""


class FactorizationError(DdicError):
    """A matrix that is not singular could not be factorised, for instance for want of memory."""


class WriteError(DdicError):
    """What was found cannot be written where it belongs, though this was possible before."""


def is_disk_failure(error: OSError) -> bool:
    """Tell whether a disk is full, broken or closed to writing, for which nobody's input is to blame."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)


_LISTED = 10


def list_first(numbers: Iterable[int]) -> str:
    """List the first ten numbers, for a message, separated by commas, with dots where there are more."""
    listed = [str(n) for n in islice(numbers, _LISTED + 1)]
    return ", ".join([*listed[:_LISTED], *(["..."] if len(listed) > _LISTED else [])])


E = TypeVar("E", bound=BaseException)


def as_collective(error: E) -> E:
    """Mark an error as raised by every rank at the same place, the same on all: the job may end without an abort."""
    error.collective = True  # type: ignore[attr-defined]  # exceptions carry attributes through pickling
    return error


def require_collective(error: BaseException) -> None:
    """Raise an error again that this rank alone has, since it must end the job."""
    if not is_collective(error):
        raise error


def is_collective(error: BaseException) -> bool:
    """Tell whether every rank raised this error, so that the job may end without an abort."""
    return bool(getattr(error, "collective", False))

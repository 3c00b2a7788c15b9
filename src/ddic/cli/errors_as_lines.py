"""Errors as lines of the command line."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from ddic.errors import DdicError, InputError, WriteError, is_disk_failure


@contextmanager
def errors_as_lines(target: Path | None = None) -> Iterator[None]:
    """End the program where the block fails, with a line for each problem on standard error.

    Parameters
    ----------
    target : Path, optional
        File or folder that the block writes to.

    Raises
    ------
    OSError
        What the block raises, where it writes to no target.
    """
    try:
        yield
    except DdicError as error:
        click.echo(str(error), err=True)
        sys.exit(error.exit_code)
    except OSError as error:
        if target is not None and _is_within(error.filename, target):
            click.echo(f"{target}: cannot be written to ({error.strerror}); choose another --output", err=True)
        elif error.filename is not None:
            click.echo(f"{os.fsdecode(error.filename)}: cannot be read or written ({error.strerror}); check the path, "
                       "its permissions and the space left", err=True)
        else:
            raise
        sys.exit(WriteError.exit_code if is_disk_failure(error) else InputError.exit_code)


def _is_within(name: str | bytes | int | None, target: Path) -> bool:
    """Whether what failed is the target, or a file in it or beside it; also where nothing tells what failed."""
    if not isinstance(name, str | bytes):
        return True
    path, place = os.path.abspath(os.fsdecode(name)), os.path.abspath(target)
    return path.startswith(place) or os.path.dirname(path) == os.path.dirname(place)

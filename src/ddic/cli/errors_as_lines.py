"""Errors as lines of the command line."""

from __future__ import annotations

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
        if target is None:
            raise
        click.echo(f"{target}: cannot be written to ({error.strerror}); choose another --output", err=True)
        sys.exit(WriteError.exit_code if is_disk_failure(error) else InputError.exit_code)

"""Words that a command does not take, told in a line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import click

from ddic.errors import InputError


@contextmanager
def usage_as_line() -> Iterator[None]:
    """Have words that a command does not take refused like other input, in place of click's four lines on each rank.

    Raises
    ------
    InputError
        Where the block raises what click says of the words.
    """
    try:
        yield
    except click.exceptions.NoArgsIsHelpError:
        raise
    except click.UsageError as error:
        said = " ".join(error.format_message().split()).rstrip(".")
        command = "ddic" if error.ctx is None else error.ctx.command_path
        raise InputError(f"{command}: {said}; see {command} --help") from error

"""Warnings as lines of the command line."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import click


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Print what is warned of inside, a line each on standard error, after the block unless it fails."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", UserWarning)
        yield
    for warning in warned:
        # Others are libraries' own, on what they do and not on what was given to them.
        if not issubclass(warning.category, UserWarning):
            continue
        click.echo(f"warning: {warning.message}", err=True)

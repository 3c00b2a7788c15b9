"""``--frame``: which frame of a series a command takes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])


def add_frame_option(command: Command) -> Command:
    """Add the option --frame to a command.

    Parameters
    ----------
    command : callable
        With a parameter ``frame`` (int or None).

    Returns
    -------
    callable
        The same.
    """
    add = click.option("--frame", type=click.IntRange(1), default=None, metavar="N",
                       help="Frame of a series that is taken, by its number.")
    return add(command)

"""Numbers on the command line: nan and infinity are none that an option takes."""

from __future__ import annotations

import math
from typing import Any

import click


def require_finite_options(command: click.Command) -> None:
    """Have a command refuse options that are not finite.

    Parameters
    ----------
    command : Command
        Its options without a callback get one; so do those of its own commands.
    """
    for parameter in command.params:
        if parameter.callback is None:
            parameter.callback = _check
    if isinstance(command, click.Group):
        for inner in command.commands.values():
            require_finite_options(inner)


def _check(_: click.Context, parameter: click.Parameter, value: Any) -> Any:
    numbers = value if isinstance(value, tuple) else (value,)
    for number in numbers:
        if isinstance(number, float) and not math.isfinite(number):
            raise click.BadParameter(f"{number} is not a finite number.", param=parameter)
    return value

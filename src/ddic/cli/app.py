"""The command line: ``ddic`` and its commands, each imported when it is called.

Of numbers, nan and infinity are none that an option takes. Words that a command does not take are told in a line.
``--frame`` says which frame of a series a command takes.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import click

from ddic import __version__
from ddic.cli.failed_start import failures_as_lines, output_as_line
from ddic.cli.surroundings import (
    imports_kept,
    prepare_idle_threads,
    require_address_space,
    require_clock,
    require_working_folder,
)
from ddic.errors import InputError


def require_finite_options(command: click.Command) -> None:
    """Have a command refuse options that are not finite.

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


@contextmanager
def usage_as_line() -> Iterator[None]:
    """Have words that a command does not take refused like other input, in place of click's four lines on each rank.

    Raises InputError where the block raises what click says of the words.
    """
    try:
        yield
    except click.exceptions.NoArgsIsHelpError:
        raise
    except click.UsageError as error:
        said = " ".join(error.format_message().split()).rstrip(".")
        command = "ddic" if error.ctx is None else error.ctx.command_path
        raise InputError(f"{command}: {said}; see {command} --help") from error


COMMANDS = {
    "run": "Measure the displacement between two images.",
    "check": "Validate all inputs of a case file without solving.",
    "synth": "Make image pairs with a known displacement.",
    "info": "Describe a result file or an image.",
    "plot": "Draw the pictures of a result file.",
    "probe": "Read points, lines, strain gauges and extensometers on results.",
    "export": "Write the fields of a result as CSV tables.",
    "report": "Write one page on a result, with what guides ask to be stated.",
    "opening": "Write the opening of discontinuities along them as a table.",
    "crack": "Find a crack's tip and its stress intensity factors.",
    "uncertainty": "Measure known displacements of a reference image, by size of the elements.",
    "sweep": "Recommend a cut-off wavelength and an element size by trying them out.",
    "calibrate": "Find where a near-field image lies in a far-field one.",
}

HOMES = {"export": "probe", "opening": "crack"}
"""Modules of commands that stand in another one's."""

CLICKS_OWN = (click.ClickException, click.exceptions.Exit, click.Abort)
"""What click ends a program with by itself."""


def find_home(name: str) -> str:
    """Find the module of a command, with dots."""
    return f"ddic.cli.{HOMES.get(name, name)}"


class LazyGroup(click.Group):
    """Commands live in ``ddic.cli.NAME``, or where ``HOMES`` says; listing them imports none."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """List the names of the commands in the order of a first session."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; None where there is no such command."""
        if cmd_name not in COMMANDS:
            return None
        with imports_kept():
            command: click.Command = getattr(importlib.import_module(find_home(cmd_name)), cmd_name)
        require_finite_options(command)
        return command

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run a command as a program; return what it returns, where click is asked for that."""
        with output_as_line():
            return super().main(*args, **extra)

    def invoke(self, ctx: click.Context) -> object:
        """Run the command; what it lets pass ends all ranks, in one line where the command could not be imported."""
        with failures_as_lines(passed=CLICKS_OWN), usage_as_line():
            require_address_space()
            require_clock()
            require_working_folder()
            prepare_idle_threads()
            return super().invoke(ctx)

    def make_context(self, info_name: str | None, args: list[str], parent: click.Context | None = None,
                     **extra: Any) -> click.Context:
        """Read the words before a command's name; ``parent`` is None for the program itself."""
        with failures_as_lines(passed=CLICKS_OWN), usage_as_line():
            return super().make_context(info_name, args, parent, **extra)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands for --help without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.command(cls=LazyGroup)
@click.version_option(__version__, prog_name="ddic")
def main() -> None:
    """Finite element digital image correlation by dual domain decomposition over MPI."""


Command = TypeVar("Command", bound=Callable[..., Any])


def add_frame_option(command: Command) -> Command:
    """Add the option --frame to a command, which has a parameter ``frame`` (int or None)."""
    add = click.option("--frame", type=click.IntRange(1), default=None, metavar="N",
                       help="Frame of a series that is taken, by its number.")
    return add(command)

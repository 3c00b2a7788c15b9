"""The command line: ``ddic`` and its commands, each imported when it is called; no option takes nan or infinity."""

import importlib
import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

from ddic import __version__
from ddic.cli.entry import require_surroundings
from ddic.cli.failures import failures_as_lines, output_as_line
from ddic.errors import InputError


def require_finite_options(command: click.Command) -> None:
    """Have a command, and commands of its own, refuse options that are not finite: those without a callback get one."""
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


COMMANDS = {
    "new": "Write a case file to start from, for a pair of images or a series.",
    "draw": "Draw a case on its image in the browser, and run it.",
    "run": "Measure the displacement between two images.",
    "compare": "Measure the displacement and compare it with a simulation.",
    "identify": "Identify the elastic parameters of a material.",
    "modes": "Measure a series as a few fields times functions of time.",
    "check": "Validate all inputs of a case file without solving.",
    "mesh": "Write the mesh of a case file, with its node sets.",
    "synth": "Make image pairs with a known displacement.",
    "info": "Describe a result file or an image.",
    "view": "Look at results in the browser.",
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

HOMES = {"calibrate": "calibrate:calibrate_near", "draw": "page:draw", "view": "page:view",
         "probe": "tables:probe", "export": "tables:export",
         "report": "info:report", "opening": "tables:opening", "crack": "tables:crack",
         "compare": "material:compare", "identify": "material:identify",
         "modes": "material:modes",
         "uncertainty": "studies:uncertainty", "sweep": "studies:sweep"}
"""Module and function of the commands whose name is not that of both."""

CLICKS_OWN = (click.ClickException, click.exceptions.Exit, click.Abort)
"""What click ends a program with by itself."""


@contextmanager
def _refusals_as_lines() -> Iterator[None]:
    """End all ranks with a line where the block fails, also for words that a command does not take.

    Of these click would tell in four lines on each rank.
    """
    with failures_as_lines(passed=CLICKS_OWN):
        try:
            yield
        except click.exceptions.NoArgsIsHelpError:
            raise
        except click.UsageError as error:
            said = " ".join(error.format_message().split()).rstrip(".")
            command = "ddic" if error.ctx is None else error.ctx.command_path
            raise InputError(f"{command}: {said}; see {command} --help") from error


class LazyGroup(click.Group):
    """Commands live in ``ddic.cli.NAME``, or where ``HOMES`` says: a module is imported when its command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """List the names of the commands in the order of a first session."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; None where there is no such command."""
        if cmd_name not in COMMANDS:
            return None
        module, _, function = HOMES.get(cmd_name, f"{cmd_name}:{cmd_name}").partition(":")
        command: click.Command = getattr(importlib.import_module(f"ddic.cli.{module}"), function)
        require_finite_options(command)
        return command

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run a command as a program; return what it returns, where click is asked for that."""
        with output_as_line():
            return super().main(*args, **extra)

    def invoke(self, ctx: click.Context) -> object:
        """Run the command."""
        with _refusals_as_lines():
            require_surroundings()
            return super().invoke(ctx)

    def make_context(self, info_name: str | None, args: list[str], parent: click.Context | None = None,
                     **extra: Any) -> click.Context:
        """Read the words before a command's name; ``parent`` is None for the program itself."""
        with _refusals_as_lines():
            return super().make_context(info_name, args, parent, **extra)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands for --help without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.command("ddic", cls=LazyGroup, context_settings={"show_default": True})
@click.version_option(__version__, prog_name="ddic")
def command_line() -> None:
    """Finite element digital image correlation by dual domain decomposition over MPI."""


frame_option = click.option("--frame", type=click.IntRange(1), metavar="N",
                            help="Frame of a series that is taken, by its number.")
"""Of a command that has a parameter ``frame`` (int or None)."""

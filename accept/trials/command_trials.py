"""Kinds of bad command lines for every command, found from the commands' own parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import click

from accept.trials.good_case import PAIR
from accept.trials.path_edits import NAME, make_own_device
from accept.trials.trial import CASE_FILE, Trial
from ddic.cli.app import COMMANDS, command_line

GOOD: Mapping[str, tuple[str, ...]] = {
    "run": (CASE_FILE,), "check": (CASE_FILE,), "uncertainty": (CASE_FILE, "--sizes", "16", "--displacements", "2"),
    "sweep": (CASE_FILE, "--lengths", "0", "--elements", "16"), "info": ("earlier.pair.vtkhdf",),
    "plot": ("earlier.pair.vtkhdf", "--kind", "partition"), "probe": ("earlier.pair.vtkhdf", "--point", "40,40"),
    "export": ("earlier.pair.vtkhdf",), "report": ("earlier.pair.vtkhdf",), "opening": ("earlier.cut.vtkhdf",),
    "crack": ("earlier.cut.vtkhdf",), "calibrate": ("far_reference.tif", "near_reference.tif", "--ratio", "3"),
    "synth": ("translation", "--size", "32x32", "--output", "made"),
}
"""Arguments with which a command succeeds; a command that is not here is tried without any."""

BAD_WORDS = ("", "nan", "-inf", "1e308", "-1", "0", "2x", "a\tb", "9" * 5000, "a" * 300, "10x" + "9" * 20)
BAD_FILES = ("missing.odd", ".", "mask.png", "points.csv", CASE_FILE, "earlier.pair.residual.vtkhdf", NAME, "")
NO_UTF8 = "\udcff"
"""A byte that is no UTF-8, as Python has it among a command's arguments."""


def list_command_trials() -> list[Trial]:
    """List bad values of every option, and bad, missing and spare arguments, of every command.

    Returns
    -------
    list of Trial
        By command.
    """
    trials = [trial for name in COMMANDS for trial in _of_command(name)]
    return [*trials, _trial((), "ends"), _trial(("nonsense",)), _trial(("--nonsense",)), _trial(("ru",))]


def _of_command(name: str) -> Iterator[Trial]:
    command = command_line.get_command(click.Context(command_line), name)
    assert command is not None
    good = GOOD.get(name, ())
    if isinstance(command, click.Group):
        yield from (_trial((name, inner), "ends") for inner in (*command.commands, "nonsense"))
        command = command.commands[good[0]]
    yield _trial((name,), "ends" if name == "synth" else "refused")
    yield _trial((name, *good, "one", "more", "words"))
    yield _trial((name, *good, "--nonsense"))
    if good and good[0] != "translation":
        yield from (_trial((name, file, *good[1:]), "refused or measured") for file in (*BAD_FILES, NO_UTF8, "a" * 300))
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            yield from _of_option(name, good, parameter)


def _of_option(name: str, good: tuple[str, ...], option: click.Option) -> Iterator[Trial]:
    spelt = option.opts[0]
    if spelt == "--help" or option.is_flag:
        return
    yield _trial((name, *good, spelt))
    yield _trial((name, *good, f"{spelt}s", "1"))
    is_path = isinstance(option.type, click.Path)
    for word in BAD_FILES if is_path else BAD_WORDS:
        values = (word,) * max(1, option.nargs)
        yield _trial((name, *good, spelt, *values), "refused or measured")


def _trial(arguments: tuple[str, ...], expected: str = "refused") -> Trial:
    shown = " ".join(word if len(word) < 40 else f"{word[:10]}...{len(word)}" for word in arguments)
    edits = (make_own_device,) if NAME in arguments else ()
    return Trial(f"ddic {shown!a}", PAIR, edits, commands=(arguments,), expected=expected)  # type: ignore[arg-type]

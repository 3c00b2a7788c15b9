"""Tries bad inputs and damaged files: ``make trials``.

Usage: python -m accept.trials [--sample N] [--jobs N] [WORD ...]: all kinds whose name holds one of the words, or
a sample of them; exit code 1 where one is not refused as it should be.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from accept.bad_inputs import choose_sample, list_bad_inputs
from accept.trials.mutants import DAMAGED, list_mutants
from accept.trials.try_all import Verdict, try_all
from bench.support.runs import DATA

N_MUTANTS = 300
"""Of each format."""


def run_trials(arguments: Sequence[str]) -> int:
    """Try what the command line asks for, and print what was wrong with each.

    Parameters
    ----------
    arguments : sequence of str
        Of the command line.

    Returns
    -------
    int
        Exit code: 1 where something was wrong.
    """
    parser = argparse.ArgumentParser(prog="python -m accept.trials")
    parser.add_argument("words", nargs="*", metavar="WORD", help="parts of names; all kinds by default")
    parser.add_argument("--sample", type=int, default=None, help="number of kinds, chosen by a seed")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    parser.add_argument("--list", action="store_true", help="list the kinds and try none")
    chosen = parser.parse_args(arguments)
    mutants = [trial for kind in DAMAGED for trial in list_mutants(kind, N_MUTANTS)]
    trials = [trial for trial in (*list_bad_inputs(), *mutants)
              if not chosen.words or any(word in trial.name for word in chosen.words)]
    if chosen.sample is not None:
        trials = choose_sample(trials, chosen.sample)
    if chosen.list:
        print(*(trial.name for trial in trials), sep="\n")
        return 0
    wrong = [verdict for verdict in try_all(trials, DATA / "trials", chosen.jobs) if verdict.faults]
    for verdict in wrong:
        _show(verdict)
    print(f"{len(trials)} kinds, {len(wrong)} not as they should be")
    return 1 if wrong else 0


def _show(verdict: Verdict) -> None:
    print(f"{verdict.trial.name}: exit codes {', '.join(map(str, verdict.codes))}")
    for fault in verdict.faults:
        print(f"    {fault}")


if __name__ == "__main__":
    sys.exit(run_trials(sys.argv[1:]))

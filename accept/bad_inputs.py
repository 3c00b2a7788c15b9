"""What ddic does with inputs that are wrong, and with files that are damaged: ``accept/trials`` as rows.

Usage: python -m accept.bad_inputs [--sample N] [--jobs N] [WORD ...]: all kinds whose name holds one of the words, or a
sample of them; exit code 1 where one is not refused as it should be.
"""

from __future__ import annotations

import argparse
import random
import sys
from collections.abc import Sequence
from pathlib import Path

from accept.table import Scale
from accept.trials.case_trials import list_command_trials, list_schema_trials
from accept.trials.file_trials import list_file_trials, list_large_images, list_uncoded_images
from accept.trials.mutants import DAMAGED, list_mutants
from accept.trials.result_trials import list_result_trials
from accept.trials.trial import ON_CASE, Trial, make_good_folder
from accept.trials.try_all import Verdict, try_all, try_apart, try_one
from accept.trials.volume_trials import list_volume_trials
from accept.trials.watched_worker import LIMIT_S, Ended, Worker
from bench.support.rows import Row, append_result
from bench.support.runs import DATA

FEWEST_KINDS, N_MUTANTS = 450, 300
EVERY_APART = 60
"""Of so many kinds on case files one is tried once more, each command a process of its own, on one and two ranks."""

LONGEST, MOST_MIB = 10.0, 1024
"""Seconds and memory that a command may take to refuse a large image: decoding it took 28 s and 2.7 GiB."""

SMOKE_KINDS, SMOKE_MUTANTS, SMOKE_APART = 12, 1, 1
SEED = 18
SHOWN = 5
"""Names that a row shows."""


def list_bad_inputs() -> list[Trial]:
    """List all kinds of bad input; those of volumes are a list of their own."""
    of_keys = [trial for trial in list_schema_trials() if not trial.name.startswith("volumes")]
    return [*of_keys, *list_file_trials(), *list_result_trials(), *list_command_trials()]


def choose_sample(trials: Sequence[Trial], n_chosen: int) -> list[Trial]:
    """Choose some trials, the same ones each time."""
    numbers = random.Random(SEED).sample(range(len(trials)), min(n_chosen, len(trials)))
    return [trials[number] for number in sorted(numbers)]


def measure_bad_inputs(scale: Scale) -> list[Row]:
    """Try every kind of bad input, and some as a user does: in processes of their own, on two ranks."""
    return try_kinds(scale, list_bad_inputs(), FEWEST_KINDS)


def try_kinds(scale: Scale, trials: Sequence[Trial], fewest: int) -> list[Row]:
    """Try kinds of bad input, of which there are to be some at least, and some as a user does."""
    folder = scale.folder("trials")
    of_cases = [trial for trial in trials if trial.commands == ON_CASE]
    apart = choose_sample(of_cases, SMOKE_APART if scale.smoke else len(of_cases) // EVERY_APART)
    bound = "exit code 2, or a measured result; one line a mistake; no traceback; nothing written; check and run agree"
    tried = choose_sample(trials, SMOKE_KINDS) if scale.smoke else trials
    # The sample of a smoke run is taken from all kinds.
    rows = [_row(f"{len(tried)} of {len(trials)} kinds of bad input, at least {fewest}", bound,
                 try_all(tried, folder, scale.jobs), len(trials) >= fewest)]
    for n_ranks in (0, 2):
        where = f"run on {n_ranks} ranks" if n_ranks else "each command a process"
        rows.append(_row(f"{len(apart)} of them, {where}", bound, try_apart(apart, folder, n_ranks)))
    return rows


def measure_mutants(scale: Scale) -> list[Row]:
    """Damage files of every format at random and give them to the commands that read them."""
    n_mutants = SMOKE_MUTANTS if scale.smoke else N_MUTANTS
    mutants = [trial for kind in DAMAGED for trial in list_mutants(kind, n_mutants)]
    verdicts = try_all(mutants, scale.folder("trials"), scale.jobs)
    bound = f"no crash, no traceback, no hang over {LIMIT_S:g} s, memory below 2 GiB"
    return [_row(f"{n_mutants} damaged files: {kind}", bound, verdicts[first:first + n_mutants])
            for kind, first in zip(DAMAGED, range(0, len(mutants), n_mutants), strict=True)]


def measure_unusual_images(scale: Scale) -> list[Row]:
    """Give images to ``ddic`` that are intact, and too large, blank or without a codec."""
    large, ended = _watch(list_large_images(), scale.folder("trials"))
    cost = ", ".join(f"{one.seconds:.1f} s and {one.peak / 2**20:.0f} MiB" for one in ended)
    what = f"{' and '.join(one.trial.name for one in large)}, a mesh all over them"
    within = all(one.seconds <= LONGEST and 0 < one.peak <= MOST_MIB * 2**20 for one in ended)
    uncoded, said = _watch(list_uncoded_images(), scale.folder("trials"))
    lines = [line for one in said for line in one.stderr.splitlines()]
    is_named = all("ZSTD" in line and "damaged" not in line for line in lines) and len(lines) == len(said)
    return [_row(f"{what}: ddic check and run", "exit code 2, one line an image, nothing written", large),
            Row(f"{what}: each command", f"<= {LONGEST:g} s, <= {MOST_MIB} MiB", cost, within, judged_small=False),
            _row(f"{uncoded[0].trial.name}: ddic check, run, info", "exit code 2, one line, nothing written", uncoded),
            Row(f"{uncoded[0].trial.name}: what they say", "each names ZSTD, and none calls the file damaged",
                f"{len(lines)} lines: {lines[-1] if lines else 'none'}", is_named)]


def _watch(trials: Sequence[Trial], folder: Path) -> tuple[list[Verdict], list[Ended]]:
    """What came of trials one after the other, and how each command ended."""
    good, ended = make_good_folder(folder / "good"), []
    with Worker() as worker:
        def run(inside: Path, arguments: Sequence[str], trial: Trial) -> Ended:
            ended.append(worker.run(inside, arguments, trial.environment))
            return ended[-1]

        return [try_one(trial, good, folder / "place_watched", run) for trial in trials], ended


def _row(check: str, bound: str, verdicts: Sequence[Verdict], enough: bool = True) -> Row:
    wrong = [verdict for verdict in verdicts if verdict.faults]
    append_result("trials", {"check": check, "wrong": {one.trial.name: one.faults for one in wrong}})
    shown = "".join(f"; {verdict.trial.name}: {verdict.faults[0][:160]}" for verdict in wrong[:SHOWN])
    peak = max((verdict.peak for verdict in verdicts), default=0)
    memory = f", {peak / 2**20:.0f} MiB at most" if peak else ""
    return Row(check, bound, f"{len(wrong)} of {len(verdicts)} are not so{memory}{shown}", enough and not wrong)


def run_trials(arguments: Sequence[str]) -> int:
    """Try what the command line asks for, and print what was wrong with each."""
    parser = argparse.ArgumentParser(prog="python -m accept.bad_inputs")
    parser.add_argument("words", nargs="*", metavar="WORD", help="parts of names; all kinds by default")
    parser.add_argument("--sample", type=int, default=None, help="number of kinds, chosen by a seed")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    parser.add_argument("--list", action="store_true", help="list the kinds and try none")
    chosen = parser.parse_args(arguments)
    mutants = [trial for kind in DAMAGED for trial in list_mutants(kind, N_MUTANTS)]
    trials = [trial for trial in (*list_bad_inputs(), *list_volume_trials(), *mutants)
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

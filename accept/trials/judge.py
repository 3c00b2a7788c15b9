"""Whether a command ended as it should on what it was given."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from accept.trials.trial import Trial
from accept.trials.watched_worker import HUNG, LIMIT_S, Ended

MOST_BYTES = 2 << 30
"""Memory of a command."""

REFUSED, MEASURED, NOT_CONVERGED = 2, 0, 1
WANTED: Mapping[str, tuple[int, ...]] = {
    "refused": (REFUSED,), "refused or measured": (REFUSED, MEASURED), "may fail": (REFUSED, MEASURED, NOT_CONVERGED),
}
MOST_CHARACTERS = 6000
"""Of all that is said of one mistake: a name may be 4096 long."""

State = Mapping[str, tuple[int, int]]


def look_at(folder: Path) -> State:
    """List what a folder holds.

    Parameters
    ----------
    folder : Path
        With folders in it.

    Returns
    -------
    mapping
        Size and time of the last change by name.
    """
    return {str(path.relative_to(folder)): (path.lstat().st_size, path.lstat().st_mtime_ns)
            for path in folder.rglob("*")}


def judge_end(ended: Ended) -> list[str]:
    """Find what no command may do, whatever it is given.

    Parameters
    ----------
    ended : Ended
        How it ended.

    Returns
    -------
    list of str
        What was wrong.
    """
    if ended.code == HUNG:
        return [f"still there after {LIMIT_S:g} s"]
    if ended.code < 0:
        return [f"ended by signal {-ended.code}"]
    faults = [f"exit code {ended.code}"] if ended.code not in (REFUSED, MEASURED, NOT_CONVERGED) else []
    if "Traceback" in ended.stderr or "Traceback" in ended.stdout:
        last = next((line for line in reversed(ended.stderr.splitlines()) if line.strip()), "")
        faults.append(f"a traceback: {last[:200]}")
    if ended.peak > MOST_BYTES:
        faults.append(f"{ended.peak / 2**30:.1f} GiB")
    return faults


def judge_refusal(trial: Trial, ended: Ended, before: State, after: State) -> list[str]:
    """Find what is wrong with a refusal.

    Parameters
    ----------
    trial : Trial
        What was tried.
    ended : Ended
        With an exit code that is not 0.
    before, after : State
        The folder's.

    Returns
    -------
    list of str
        What was wrong.
    """
    faults = []
    lines = list_mistakes(ended.stderr)
    if not 1 <= len(lines) <= trial.n_mistakes:
        faults.append(f"{len(lines)} lines: {' | '.join(line[:120] for line in lines[:4])}")
    if len(ended.stderr) > MOST_CHARACTERS:
        faults.append(f"{len(ended.stderr)} characters are said")
    changed = sorted(name for name in {*before, *after} if before.get(name) != after.get(name))
    if ended.code == REFUSED and changed:
        faults.append(f"written: {', '.join(changed[:5])}")
    return faults


def list_mistakes(stderr: str) -> list[str]:
    """List the lines that tell of a mistake: not warnings.

    Parameters
    ----------
    stderr : str
        What was printed.

    Returns
    -------
    list of str
        Lines.
    """
    return [line for line in stderr.splitlines() if line.strip() and not line.startswith("warning: ")]


def judge_codes(trial: Trial, codes: Sequence[int]) -> Iterable[str]:
    """Find whether commands agree with what is expected and with one another.

    Parameters
    ----------
    trial : Trial
        What was tried.
    codes : sequence of int
        Exit codes of its commands; those after one that hung are missing.

    Yields
    ------
    str
        What was wrong.
    """
    if trial.expected == "ends":
        return
    for command, code in zip(trial.commands, codes, strict=False):
        wanted = WANTED[trial.expected]
        if code not in wanted and code >= 0:
            yield f"{command[0]}: exit code {code}, {' or '.join(map(str, wanted))} expected"
    by_name = {command[0]: code for command, code in zip(trial.commands, codes, strict=False)}
    if "check" in by_name and "run" in by_name and (by_name["check"] == REFUSED) != (by_name["run"] == REFUSED):
        yield f"check ends with {by_name['check']}, run with {by_name['run']}"

"""The whole command now and before: wall time, CPU time and memory on the same images, alternated.

Usage: python -m bench.before [--rounds N] [--commit C] [CASE ...]; cases: beam, tension (28 Mpx, 221,136 unknowns),
waves (29 Mpx), demo, openhole (real images, DDIC_REAL_DATA), tiny; all but tiny by default. Every comparison is one
record of bench/results/before.jsonl.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

import psutil

from bench.support.before import COMMIT, checkout_before
from bench.support.paper_case import beam, describe_tension, full, name_images, tiny
from bench.support.rows import append_result
from bench.support.runs import DATA, ROOT, environment, images, mpirun, real_data

RANKS = 2

ROUNDS = 3
"""Runs of each source, in turn; medians are compared. Each runs once before, which compiles its kernels."""

AS_INSTALLED = {"PYTHONDONTWRITEBYTECODE": ""}
"""Variables of the runs: where Python keeps no bytecode, each run would compile all modules, which no user's does."""


@dataclass(frozen=True)
class Cost:
    """What a whole command took.

    Attributes
    ----------
    wall : float
        Seconds from the start of mpiexec until it has ended.
    cpu : float
        Seconds of all its processes together, the launcher's too.
    memory : float
        Largest resident memory of each rank, all ranks together, bytes.
    iterations : int
        Of Gauss-Newton.
    """

    wall: float
    cpu: float
    memory: float
    iterations: int


@dataclass(frozen=True)
class Comparison:
    """A case measured before and now.

    Attributes
    ----------
    case : str
        Its name.
    before, now : Cost
        Medians of the runs.
    """

    case: str
    before: Cost
    now: Cost

    @property
    def wall(self) -> float:
        """Wall time now over that before."""
        return self.now.wall / self.before.wall

    @property
    def cpu(self) -> float:
        """CPU time now over that before."""
        return self.now.cpu / self.before.cpu

    @property
    def memory(self) -> float:
        """Memory now over that before."""
        return self.now.memory / self.before.memory

    def describe(self) -> str:
        """Say the ratios, and what they are ratios of.

        Returns
        -------
        str
            Words.
        """
        then, now = self.before, self.now
        return (f"{self.wall:.2f}, {self.cpu:.2f} and {self.memory:.2f} times the wall time, CPU time and memory "
                f"({now.wall:.2f} beside {then.wall:.2f} s, {now.cpu:.2f} beside {then.cpu:.2f} CPU s, "
                f"{now.memory / 2**30:.2f} beside {then.memory / 2**30:.2f} GiB; {now.iterations} and "
                f"{then.iterations} iterations)")


def _demo() -> str:
    """The case of ``make demo``; its images are named from wherever the case stands."""
    folder = images("kirsch", "--size", "1000x1000", "--strain", "0.005", "--radius", "100", "--noise", "2",
                    "--seed", "1", folder=DATA / "before" / "demo_images")
    text = (ROOT / "examples" / "demo" / "case.toml").read_text(encoding="utf-8")
    return text.partition("[output]")[0].replace('"images/', f'"{folder}/')


def _openhole() -> str:
    """The real tension test, frames 53 and 70, at defaults."""
    folder = real_data() / "openhole"
    return (f'{name_images(folder / "zoom-0053_1.tif", folder / "zoom-0070_1.tif")}'
            f'[mesh]\nfile = "{folder}/mesh_q4_pixels.msh"\n[solver]\nmethod = "dual"\nsubdomains = 8\n')


CASES: dict[str, Callable[[], str]] = {
    "beam": lambda: beam(8).measured, "tension": lambda: describe_tension(DATA / "tension"),
    "waves": lambda: full(16).measured, "demo": _demo,
    "openhole": _openhole, "tiny": lambda: tiny().measured,
}
"""Text of each case by name, without its output; keys that the code before knew too."""

MEASURED = ("beam", "tension", "waves", "demo", "openhole")
"""Cases that a table shows."""


def compare(name: str, rounds: int = ROUNDS, commit: str = COMMIT) -> Comparison:
    """Measure a case with the code before and with this one, in turn.

    Parameters
    ----------
    name : str
        Of the case.
    rounds : int
        Timed runs of each.
    commit : str
        Of the code before.

    Returns
    -------
    Comparison
        Medians; kept in bench/results/before.jsonl.

    Raises
    ------
    NotHereError
        Where the repository's history does not reach back so far, or real images are missing.
    """
    sources = {"before": checkout_before(commit), "now": ROOT}
    text = CASES[name]()
    runs: dict[str, list[Cost]] = {which: [] for which in sources}
    for number in range(rounds + 1):
        for which, source in sources.items():
            cost = _measure(text, DATA / "before" / name, which, source)
            if number > 0:
                runs[which].append(cost)
    found = Comparison(name, _find_median(runs["before"]), _find_median(runs["now"]))
    append_result("before", {"before": commit, "case": name, "n_ranks": RANKS,
                             **{which: [asdict(cost) for cost in costs] for which, costs in runs.items()}})
    return found


def compare_starts(earlier: Path, rounds: int = ROUNDS) -> tuple[float, float]:
    """Measure ``ddic run`` on the demo, alone, up to its first line of output, with the code before and now in turn.

    Parameters
    ----------
    earlier : Path
        Checkout of the code before.
    rounds : int
        Timed runs of each.

    Returns
    -------
    before, now : float
        Medians of CPU seconds.
    """
    sources = {"before": earlier, "now": ROOT}
    folder = DATA / "before" / "demo"
    folder.mkdir(parents=True, exist_ok=True)
    runs: dict[str, list[float]] = {which: [] for which in sources}
    for number in range(rounds + 1):
        for which, source in sources.items():
            case = folder / f"started_{which}.toml"
            case.write_text(f'{_demo()}\n[output]\nfile = "started_{which}.vtkhdf"\n', encoding="utf-8")
            cpu = _time_first_line(case, source)
            if number > 0:
                runs[which].append(cpu)
    append_result("starts", {"before": earlier.name, **{f"{which}_cpu_s": cpu for which, cpu in runs.items()}})
    return median(runs["before"]), median(runs["now"])


def _time_first_line(case: Path, source: Path) -> float:
    """CPU seconds that a run has taken when its first line can be read; it is ended there."""
    with subprocess.Popen([sys.executable, "-m", "ddic", "run", str(case)], stdout=subprocess.PIPE,
                          stderr=subprocess.DEVNULL, text=True,
                          env=environment({"PYTHONPATH": str(source / "src"), **AS_INSTALLED})) as run:
        assert run.stdout is not None
        line = run.stdout.readline()
        used = psutil.Process(run.pid).cpu_times()
        run.kill()
    if not line:
        raise RuntimeError(f"ddic run {case} printed nothing")
    return float(used.user + used.system)


def _measure(text: str, folder: Path, which: str, source: Path) -> Cost:
    """One run of a source's package."""
    folder.mkdir(parents=True, exist_ok=True)
    case = folder / f"{which}.toml"
    case.write_text(f'{text}\n[output]\nfile = "{which}.vtkhdf"\n', encoding="utf-8")
    cpu_before, began = _read_cpu_of_children(), time.perf_counter()
    # Not the command beside the interpreter: where the program begins is a part of what is compared.
    mpirun(RANKS, sys.executable, "-m", "ddic", "run", str(case),
           changes={"PYTHONPATH": str(source / "src"), **AS_INSTALLED})
    wall, cpu = time.perf_counter() - began, _read_cpu_of_children() - cpu_before
    summary = json.loads(case.with_suffix(".json").read_text(encoding="utf-8"))
    return Cost(wall, cpu, sum(summary["peak_memory_bytes"]), summary["iterations"])


def _read_cpu_of_children() -> float:
    """CPU seconds of all processes that this one, or one of them, started and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _find_median(runs: Sequence[Cost]) -> Cost:
    """Each figure's median."""
    return Cost(median(run.wall for run in runs), median(run.cpu for run in runs),
                median(run.memory for run in runs), runs[-1].iterations)


def main() -> None:
    """Compare the named cases, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", choices=[*CASES, []], metavar="CASE")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help=f"timed runs of each, default {ROUNDS}")
    parser.add_argument("--commit", default=COMMIT, help=f"the code before, default {COMMIT}")
    chosen = parser.parse_args()
    for name in chosen.cases or MEASURED:
        sys.stdout.write(f"{name}: {compare(name, chosen.rounds, chosen.commit).describe()}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()

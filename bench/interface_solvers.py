"""Set-up, solve and memory of one linear step: the interface solvers, direct solvers and multigrid.

Usage: python -m bench.interface_solvers [--dim D] [--sizes N ...] [--wavelengths PX ...] [--ranks R ...]
[--solvers NAME ...] [--per-subdomain E ...] [--repeats K] [--timeout S] [--append] [--fit] [--best]; everything by
default, for hours.

Squares of n x n Q4 of 16 px, or cubes of n x n x n Hex8, with a tiled random texture. Every run is a fresh process or
group of processes; repeats alternate between the solvers. Seconds are CPU seconds of the slowest rank, medians of the
repeats: wall time means little where others compute. A JSON line per run goes to bench/results/interface_solvers.jsonl
(interface_solvers_3d.jsonl of cubes), started afresh without --append, and the table of all its lines to a .md file of
that name. At the end the constants of the cost model of solver.method = "auto" are fitted to all lines of the file and
printed as src/ddic/solvers/step_costs.py has them; --fit does that alone. --best prints the table of docs/solver.md
that says which method is best.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from statistics import median
from typing import Any, Literal

from bench.support.cost_fit import fit_constants, list_missing
from bench.support.rows import RESULTS, append_result
from bench.support.runs import DATA, ROOT, environment
from bench.support.tiled_texture import CELL
from ddic.solvers.step_costs import StepCandidate, StepMethod, StepTask, predict_costs

JOB = "bench.support.interface_job"
NAMES = {2: "interface_solvers", 3: "interface_solvers_3d"}
"""Of result files, by dimension."""
SIZES = {2: (172, 353, 707, 1414), 3: (16, 24, 32, 40)}
"""Elements along a side, by dimension: about 60 000, 250 000, 1 and 4 million unknowns; 15 000 to 207 000."""
WAVELENGTHS = (0.0, 64.0, 128.0, 512.0)
"""Pixels; 0: without regularization."""
RANKS = (1, 2)
SOLVERS = ("cholmod", "assembled", "low_rank", "conjugate_gradient", "matching", "two_level", "scaled", "paper", "gamg",
           "hpddm")
DUAL = ("two_level", "scaled", "paper")
SUBDOMAINS = (*DUAL, "conjugate_gradient")
"""Solvers whose time depends on the subdomains."""
PER_SUBDOMAIN = {2: (0, 20, 40), 3: (0, 6, 8)}
"""Elements along a subdomain's side, of the dual solvers, by dimension; 0: one subdomain a rank."""
TIMEOUT_S = 600.0
"""Seconds after which a run is given up."""
REPEATED_UP_TO = 300_000
"""Unknowns up to which runs are repeated: larger ones take minutes each."""
MEMORY = 20 * 2**30
"""Address space of all ranks of a run together, bytes: a run that asks for more is out of memory."""
TITLES = {"cholmod": "monolithic, CHOLMOD", "assembled": "assembled, MUMPS",
          "low_rank": "assembled, MUMPS in blocks of low rank",
          "conjugate_gradient": "conjugate gradients, diagonal",
          "matching": "conjugate gradients, matching", "two_level": "dual, two-level",
          "scaled": "dual, one level, scaled", "paper": "dual, one level, paper's", "gamg": "CG + GAMG",
          "hpddm": "CG + PCHPDDM"}


def run(solver: str, per_subdomain: int | None, n: int, wavelength: float, ranks: int,
        timeout: float, dim: int = 2) -> dict[str, Any]:
    """One run in fresh processes; its record, with the outcome "solved" or why not."""
    folder = DATA / NAMES[2]
    folder.mkdir(parents=True, exist_ok=True)
    task = {"solver": solver, "n": n, "wavelength": wavelength, "per_subdomain": per_subdomain, "dim": dim,
            "reference": str(folder / f"reference_{n}_{wavelength:g}_{dim}.npy")}
    launcher = [os.environ.get("MPIEXEC", "mpiexec"), "-n", str(ranks)]
    # The limit is each process's: a rank that ran away would take the whole machine with it.
    limited = ["bash", "-c", f'ulimit -v {MEMORY // ranks // 1024}; exec "$@"', "limited"]
    done = subprocess.run(["timeout", f"{timeout:g}", *launcher, *limited, sys.executable, "-m", "mpi4py", "-m",
                           JOB, json.dumps(task)], cwd=ROOT, env=environment(), text=True,
                          capture_output=True, check=False)
    record = {"solver": solver, "per_subdomain": per_subdomain, "n": n, "cut_off_wavelength": wavelength,
              "n_ranks": ranks, "n_dofs": count_unknowns(n, dim), "timeout": timeout, "dim": dim,
              "petsc_options": os.environ.get("PETSC_OPTIONS", "")}
    if done.returncode == 0:
        return {**record, "outcome": "solved", **json.loads(done.stdout.splitlines()[-1])}
    return {**record, "outcome": _reason(done.returncode, done.stderr), "stderr": done.stderr[-1500:]}


def count_unknowns(n: int, dim: int) -> int:
    """Unknowns of n elements along each side."""
    return int(dim * (n + 1) ** dim)


def _reason(code: int, stderr: str) -> str:
    if code == 124:
        return "timeout"
    if any(sign in stderr for sign in ("MemoryError", "emory requested", "error code 55", "INFOG(1)=-13",
                                       "Cannot allocate memory", "Killed", "signal 9", "std::bad_alloc")):
        return "out of memory"
    # A factor that could not be made does not always say so at once: PETSc then fills the solution with nan.
    if "residual nan" in stderr or "residual inf" in stderr:
        return "failed: not a number"
    if "did not converge" in stderr:
        return "not converged"
    if "error code 86" in stderr:
        return "not in this PETSc"
    return "failed"


def measure(chosen: argparse.Namespace) -> None:
    """All runs, a line of text each; a combination that failed is not repeated."""
    for n in chosen.sizes:
        for wavelength in chosen.wavelengths:
            combinations = [(s, size, ranks) for ranks in chosen.ranks for s in chosen.solvers
                            for size in (chosen.per_subdomain if s in SUBDOMAINS else [None])
                            if not (s == "cholmod" and ranks > 1)
                            and not (s in DUAL and size == 0 and ranks == 1)
                            and not (s == "conjugate_gradient" and size == max(chosen.per_subdomain))
                            and not (s == "matching" and wavelength == 0)
                            and not (s == "hpddm" and (n > min(chosen.sizes) or ranks > 1))]
            for _ in range(chosen.repeats if count_unknowns(n, chosen.dim) <= REPEATED_UP_TO else 1):
                for combination in list(combinations):
                    solver, size, ranks = combination
                    record = run(solver, size, n, wavelength, ranks, chosen.timeout, chosen.dim)
                    append_result(NAMES[chosen.dim], record)
                    if record["outcome"] != "solved":
                        combinations.remove(combination)
                    print(row([record]), flush=True)


def row(records: Sequence[dict[str, Any]]) -> str:
    """A line of the table from the runs of one combination."""
    last = records[-1]
    size = f"{last['n_dofs']:,}".replace(",", " ")
    options = f" ({last['petsc_options']})" if last["petsc_options"] else ""
    start = (f"| {size} | {last['cut_off_wavelength']:g} | {last['n_ranks']} | {TITLES[last['solver']]}{options} | "
             f"{last['per_subdomain'] or ''} |")
    solved = [r for r in records if r["outcome"] == "solved"]
    if not solved:
        outcome = last['outcome'] + (f" ({last['timeout']:g} s)" if last['outcome'] == "timeout" else "")
        return f"{start} {outcome} | | | | |"
    setup, solve = (median(r[f"{part}_cpu"] for r in solved) for part in ("setup", "solve"))
    memory = median(max(r["peak_memory_bytes"]) for r in solved) / 2**30
    error = last["difference"]
    return (f"{start} {setup:.1f} | {solve:.2f} | {last['iterations'] or 'direct'} | {memory:.2f} | "
            f"{'reference' if error is None else f'{error:.0e}'} |")


def fit(dim: int) -> str:
    """The constants of ddic's cost model, fitted to all lines of the result file, as text of their module."""
    records = read_records(dim)
    missing = list_missing(records)
    if missing:
        return f"no constants are fitted: there are no runs of {', '.join(missing)}"
    return f"{'PLANE' if dim == 2 else 'VOLUME'} = {fit_constants(records)}"


def read_records(dim: int) -> list[dict[str, Any]]:
    """All lines of the result file."""
    lines = (RESULTS / f"{NAMES[dim]}.jsonl").read_text(encoding="utf-8").splitlines()
    return [json.loads(line) for line in lines]


def table(dim: int) -> Iterator[str]:
    """The table of all lines of the result file."""
    records = read_records(dim)

    def place(r: dict[str, Any]) -> tuple[int, float, int, int, int, str]:
        return (r["n"], r["cut_off_wavelength"], r["n_ranks"], SOLVERS.index(r["solver"]), r["per_subdomain"] or 0,
                r["petsc_options"])

    yield ("| unknowns | l_c, px | ranks | solver | elements a subdomain's side | set-up, CPU s | solve, CPU s | "
           "iterations | GiB a rank | error |")
    yield "|---|---|---|---|---|---|---|---|---|---|"
    for key in sorted({place(r) for r in records}):
        yield row([r for r in records if place(r) == key])


OWN: dict[str, tuple[StepMethod, Literal["none", "scaled", "two_level"]]] = {
    "assembled": ("assembled", "none"), "conjugate_gradient": ("conjugate_gradient", "none"),
    "matching": ("matching", "none"), "scaled": ("dual", "scaled"), "two_level": ("dual", "two_level")}
"""ddic's methods and their preconditioners by the name of a solver here."""
MODEL_RANKS = 64


def best(dim: int) -> Iterator[str]:
    """By size and cut-off wavelength, ddic's method that is fastest and the one that takes least memory.

    On two ranks as the result file has it; on 64 as the cost model of ``solver.method = "auto"`` predicts.
    """
    yield (f"| unknowns | l_c, elements | 2 ranks, measured: fastest | least memory | {MODEL_RANKS} ranks, predicted: "
           "fastest | least memory |")
    yield "|---|---|---|---|---|---|"
    solved = [r for r in read_records(dim) if r["outcome"] == "solved" and r["n_ranks"] == 2 and r["solver"] in OWN]
    for n, wavelength in sorted({(r["n"], r["cut_off_wavelength"]) for r in solved}):
        runs: dict[tuple[str, int], list[dict[str, Any]]] = {}
        for r in solved:
            if (r["n"], r["cut_off_wavelength"]) == (n, wavelength):
                runs.setdefault((r["solver"], r["per_subdomain"] or 0), []).append(r)
        measured = {_name(*key): (median(r["setup_cpu"] + r["solve_cpu"] for r in of_key),
                                  median(max(r["peak_memory_bytes"]) for r in of_key)) for key, of_key in runs.items()}
        task = StepTask(count_unknowns(n, dim), n**dim, wavelength / CELL, MODEL_RANKS, 1, dim=dim)
        costs = {key: predict_costs(task, _candidate(*key, task)) for key in runs}
        predicted = {_name(*key): (cost.seconds, cost.memory) for key, cost in costs.items()}
        cells = [_tell_best(found, which) for found in (measured, predicted) for which in (0, 1)]
        yield f"| {task.n_unknowns:,} | {wavelength / CELL:g} | {' | '.join(cells)} |"


def _name(solver: str, per_subdomain: int) -> str:
    """What the table calls a run: a subdomain's elements stand behind the method."""
    short = {"assembled": "MUMPS", "conjugate_gradient": "CG", "matching": "CG, matching", "scaled": "dual",
             "two_level": "two-level"}[solver]
    return f"{short} of {per_subdomain}" if solver in DUAL and per_subdomain else short


def _candidate(solver: str, per_subdomain: int, task: StepTask) -> StepCandidate:
    """The way of a run as the cost model calls it, with at least a subdomain a rank."""
    n_subdomains = max(task.n_cells // per_subdomain**task.dim, task.n_ranks) if per_subdomain else task.n_ranks
    method, preconditioner = OWN[solver]
    return StepCandidate(method, n_subdomains, preconditioner)


def _tell_best(costs: dict[str, tuple[float, float]], which: int) -> str:
    """The name of the least, 0: seconds, 1: bytes; and what the next one takes."""
    least, *others = sorted(costs, key=lambda name: costs[name][which])
    unit, digits = (1.0, "s") if which == 0 else (2.0**30, "GiB")
    following = f"; {others[0]} {costs[others[0]][which] / unit:.2g}" if others else ""
    return f"{least} {costs[least][which] / unit:.2g} {digits}{following}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dim", type=int, choices=SIZES, default=2, help="2: squares, 3: cubes")
    parser.add_argument("--sizes", nargs="+", type=int, help="elements along a side")
    parser.add_argument("--wavelengths", nargs="+", type=float, default=list(WAVELENGTHS), help="px")
    parser.add_argument("--ranks", nargs="+", type=int, default=list(RANKS))
    parser.add_argument("--solvers", nargs="+", choices=SOLVERS, default=list(SOLVERS))
    parser.add_argument("--per-subdomain", nargs="+", type=int, help="elements along a subdomain's side; 0: one a rank")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--timeout", type=float, default=TIMEOUT_S, help="seconds a run")
    parser.add_argument("--append", action="store_true", help="keep the lines of earlier runs")
    parser.add_argument("--fit", action="store_true", help="fit constants to the runs that are there, run nothing")
    parser.add_argument("--best", action="store_true", help="say which method is best, by the runs that are there")
    chosen = parser.parse_args()
    chosen.sizes = chosen.sizes or SIZES[chosen.dim]
    chosen.per_subdomain = chosen.per_subdomain or PER_SUBDOMAIN[chosen.dim]
    if chosen.best:
        print("\n".join(best(chosen.dim)))
        return
    if chosen.fit:
        print(fit(chosen.dim))
        return
    RESULTS.mkdir(parents=True, exist_ok=True)
    name = NAMES[chosen.dim]
    if not chosen.append:
        (RESULTS / f"{name}.jsonl").unlink(missing_ok=True)
    for stale in [] if chosen.append else (DATA / NAMES[2]).glob(f"reference_*_{chosen.dim}.npy"):
        stale.unlink()
    measure(chosen)
    text = "\n".join(table(chosen.dim)) + "\n"
    (RESULTS / f"{name}.md").write_text(text, encoding="utf-8")
    print(text)
    print(fit(chosen.dim))


if __name__ == "__main__":
    main()

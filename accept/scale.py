"""From two cores to a thousand: what grows with the ranks, the coarse problem, a gigapixel, the dual beside MUMPS.

144 ranks share the cores of this machine, so that nothing is timed but work that communicates with nobody, and bytes
and memory are counted; 36 jobs of four ranks at the same time crowd the machine as much. The model says what 1,000
ranks would take, from these counts and what ``bench/support/paper_scaling_model.py`` assumes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from accept.table import Scale
from bench import before, big, interface_solvers, scaling
from bench.support.paper_case import TOLERANCE
from bench.support.paper_scaling_model import (
    BANDWIDTH,
    BYTES,
    DISK,
    LATENCY_S,
    NODE_RANKS,
    PER_RANK_PX,
    all_phases,
    build_models,
    entry,
    find_root_work,
    find_uneven_work,
)
from bench.support.rows import Row
from bench.support.tiled_texture import CELL

BEFORE = "53d59106"
"""Commit before anything was spread over the ranks."""

FEW, MANY = 4, 144
"""Ranks."""

MOST_WORK, MOST_BYTES, MOST_MEMORY = 1.3, 20_000, 1.15
"""Times the work of a rank that others wait for, bytes a rank of the job, times the memory of a rank."""

MOST_MODEL_S = 20.0
RATES_SIZE, SMOKE_SIZE = 5000, 1000
"""Side of the square whose pixels give the model's rates, and of a smoke run's, pixels."""


def measure_ranks(scale: Scale) -> list[Row]:
    """Count what ranks do, few and many, and what the model makes of it."""
    many = 2 * 2 if scale.smoke else MANY
    of_few, of_many = scaling.weak(FEW, many // FEW), scaling.weak(many)
    cases = f"{FEW} and {many} ranks, 400 Q4 of 16 px a rank, l_c = {scaling.SHORT} and {scaling.LONG} px"
    crowd = f"{many // FEW} jobs of {FEW} ranks at the same time"
    keys = 'solver.method = "dual", solver.subdomains = ranks, solver.preconditioner = "scaled" and "two_level"'
    few, now = _group(of_few), _group(of_many)
    rows = [
        _compare(f"work of any one rank that others wait for, {cases}; {keys}; {crowd}", MOST_WORK,
                 {case: (1e3 * _find_alone(few[case]), 1e3 * _find_alone(now[case])) for case in now}, "CPU ms"),
        _judge_bytes(f"bytes that one rank deals out or gathers, result aside, {cases}; {keys}", few, now),
        _compare(f"memory of the largest rank, {cases}; {keys}; {crowd}", MOST_MEMORY,
                 {case: (_find_memory(few[case]), _find_memory(now[case])) for case in now}, "MiB"),
    ]
    return rows if scale.smoke else [*rows, _run_model(of_many)]


Records = Sequence[dict[str, Any]]


def _group(records: Records) -> dict[str, Records]:
    """Records of all jobs by case: short or long cut-off wavelength."""
    return {name: [record for record in records if f"_{name}" in record["case"]] for name in ("short", "long")}


def _find_alone(records: Records) -> float:
    """CPU seconds: rank 0's of the middle job, and of the rank that has most more than another one."""
    return median(map(find_root_work, records)) + max(map(find_uneven_work, records))


def _find_memory(records: Records) -> float:
    """Largest resident memory of a rank, MiB."""
    return float(max(max(record["memory_bytes"]) for record in records) / 2**20)


def _compare(what: str, most: float, found: dict[str, tuple[float, float]], unit: str) -> Row:
    """How much larger a quantity is with many ranks."""
    told = "; ".join(f"{case} l_c: {now / few:.2f} times ({few:.1f} and {now:.1f} {unit})"
                     for case, (few, now) in found.items())
    return Row(what, f"grows by at most {most:g} times", told, all(now <= most * few for few, now in found.values()),
               judged_small=False)


def _judge_bytes(what: str, few: dict[str, Records], now: dict[str, Records]) -> Row:
    """Bytes over ranks: those of a start that reads a coarse image whole do not grow, and few ranks share them."""
    of_few, of_many = ({case: _count_bytes(records[0]) for case, records in found.items()} for found in (few, now))
    told = "; ".join(f"{case} l_c: {of_many[case] / 1e3:.1f} kB a rank of the many, {of_few[case] / 1e3:.1f} of the few"
                     for case in of_many)
    return Row(what, f"at most {MOST_BYTES / 1e3:g} kB a rank of the many", told,
               all(value <= MOST_BYTES for value in of_many.values()), judged_small=False)


def _count_bytes(record: dict[str, Any]) -> float:
    """Bytes that the rank with most of them deals out, gathers and is given of all, before the result is written."""
    before_result = set(all_phases(record)) - {"write"}
    n_bytes = entry(record, before_result, ("scatter", "gather", "message", "allgather"), BYTES)
    return n_bytes / float(record["n_ranks"])


def _run_model(of_many: Records) -> Row:
    """What a thousand ranks would take."""
    rates = big.run(big.square(RATES_SIZE, big.by_dual(RATES_SIZE)))
    runs = [*scaling.weak(FEW), *of_many]
    model = build_models(runs, scaling.coarse(), rates)[-1]
    seconds = model.seconds()
    total = sum(seconds.values())
    told = ", ".join(f"{name} {value:.2g} s" for name, value in sorted(seconds.items(), key=lambda item: -item[1]))
    return Row(f"model of {model.n_ranks:,} ranks, {model.n_ranks * PER_RANK_PX / 1e9:g} Gpx, one subdomain a rank, "
               f"from these counts; assumed: {LATENCY_S * 1e6:g} microseconds a message, {BANDWIDTH / 1e9:g} GB/s into "
               f"a rank, {NODE_RANKS} ranks a node, {DISK / 1e9:g} GB/s between a node and the disk, cores as fast as "
               "this one, the coarse problem on one of them", f"at most {MOST_MODEL_S:g} s in all",
               f"{total:.1f} s: {told}", total <= MOST_MODEL_S)


COARSE_SIDES, PER_SUBDOMAIN, COARSE_RANKS = (160, 320), 10, 8
"""Elements along the sides of the squares and of a subdomain; ranks."""
MOST_VECTORS, MOST_ITERATIONS, MOST_FACTOR_S = 25, 25, 2.0
"""Coarse unknowns a subdomain, Krylov iterations, CPU seconds of the rank that factorises longest."""


def measure_coarse(scale: Scale) -> list[Row]:
    """Count the coarse problem's unknowns, iterations and work of a rank."""
    n_ranks = 2 if scale.smoke else COARSE_RANKS
    rows = []
    for n in (40,) if scale.smoke else COARSE_SIDES:
        wavelength = 4 * CELL * PER_SUBDOMAIN
        record = _solve("two_level", n, wavelength, n_ranks, PER_SUBDOMAIN)
        vectors, seconds = record["coarse_vectors"] / record["n_subdomains"], record["coarse_factor_cpu_s"]
        rows.append(Row(
            f"coarse problem of {record['n_subdomains']:,} subdomains of {PER_SUBDOMAIN} x {PER_SUBDOMAIN} Q4, l_c = "
            f"4 H, {n_ranks} ranks; solver.preconditioner = \"two_level\"",
            f"at most {MOST_VECTORS} unknowns a subdomain and {MOST_ITERATIONS} iterations; no rank factorises for "
            f"more than {MOST_FACTOR_S:g} s",
            f"{vectors:.1f} unknowns a subdomain, {record['iterations']} iterations; {seconds:.2f} CPU s of the rank "
            "that factorises longest, waiting included",
            vectors <= MOST_VECTORS and record["iterations"] <= MOST_ITERATIONS and seconds <= MOST_FACTOR_S))
    return rows


GIGAPIXEL, ELEMENT, WAVELENGTH = 31_700, 16, 64
"""Side of the square, of an element, and cut-off wavelength, pixels."""
MOST_GIB = 24.0


def measure_gigapixel(scale: Scale) -> list[Row]:
    """Measure a gigapixel on two ranks by defaults."""
    size = SMOKE_SIZE if scale.smoke else GIGAPIXEL
    record = big.run(big.square(size, 'method = "auto"', ELEMENT, WAVELENGTH))
    memory = record["memory_total_bytes"] / 2**30
    return [Row(f"{size:,} x {size:,} px, {record['n_dofs']:,} unknowns, Q4 of {ELEMENT} px, l_c = {WAVELENGTH} px, 2 "
                f"ranks; gauss_newton.tolerance = {TOLERANCE}", f"runs in {MOST_GIB:g} GiB",
                f"{record['wall_s']:.0f} s wall, {record['cpu_s_of_phases']:.0f} CPU s, {memory:.1f} GiB; RMS error "
                f"{record['rms_error_px']:.5f} px", memory <= MOST_GIB)]


FACTORS = ("assembled", "low_rank")
"""MUMPS's: of full rank, and in blocks of low rank with conjugate gradients."""
DUAL_SIDES, DUAL_WAVELENGTHS, DUAL_SUBDOMAIN = (353, 707), (64.0, 512.0), 20
"""Elements along the squares' sides; l_c in pixels, 4 and 32 elements; elements along a subdomain's side, as ``auto``
chooses."""
ALTERNATED = 3
MOST_OF_MUMPS, MOST_OF_LARGEST = (1.0, 0.8), (0.8, 0.6)
"""Times the CPU time and the memory of the better factor; of the largest square at the short wavelength."""


def measure_dual(scale: Scale) -> list[Row]:
    """Solve one linear step by the dual method and by MUMPS's factors, in turn."""
    return [_compare_factors(n, wavelength, scale) for n in ((40,) if scale.smoke else DUAL_SIDES)
            for wavelength in DUAL_WAVELENGTHS[:1 if scale.smoke else None]]


@dataclass(frozen=True)
class _Cost:
    """Medians: CPU seconds of the slowest rank, memory of the largest one in GiB."""

    cpu: float
    memory: float


def _compare_factors(n: int, wavelength: float, scale: Scale) -> Row:
    solvers: dict[str, int | None] = {**dict.fromkeys(FACTORS), "scaled": DUAL_SUBDOMAIN}
    runs = [{solver: _solve(solver, n, wavelength, 2, size) for solver, size in solvers.items()}
            for _ in range(1 if scale.smoke else ALTERNATED)]
    costs = {solver: _Cost(median(run[solver]["setup_cpu"] + run[solver]["solve_cpu"] for run in runs),
                           median(max(run[solver]["peak_memory_bytes"]) for run in runs) / 2**30)
             for solver in solvers}
    of_dual = costs["scaled"]
    cpu, memory = (getattr(of_dual, kind) / min(getattr(costs[factor], kind) for factor in FACTORS)
                   for kind in ("cpu", "memory"))
    is_largest = n == DUAL_SIDES[-1] and wavelength == DUAL_WAVELENGTHS[0]
    most_cpu, most_memory = MOST_OF_LARGEST if is_largest else MOST_OF_MUMPS
    told = ", ".join(f"{interface_solvers.TITLES[solver]} {cost.cpu:.1f} CPU s and {cost.memory:.2f} GiB"
                     for solver, cost in costs.items())
    last = runs[-1]["scaled"]
    return Row(f"{last['n_dofs']:,} unknowns, l_c of {wavelength / CELL:g} elements, 2 ranks: dual, "
               f"{last['n_subdomains']} subdomains, beside the better of MUMPS's factors, {len(runs)} runs alternated",
               f"at most {most_cpu:g} times the CPU time and {most_memory:g} times the memory",
               f"{cpu:.2f} and {memory:.2f} times ({told}; {last['iterations']} iterations)",
               cpu <= most_cpu and memory <= most_memory, judged_small=False)


def _solve(solver: str, n: int, wavelength: float, n_ranks: int, per_subdomain: int | None) -> dict[str, Any]:
    """One linear step; raises RuntimeError where it is not solved."""
    record = interface_solvers.run(solver, per_subdomain, n, wavelength, n_ranks, interface_solvers.TIMEOUT_S)
    if record["outcome"] != "solved":
        raise RuntimeError(f"{solver}, {n} x {n} elements: {record['outcome']}")
    return record


SMALL, MOST_OF_BEFORE, ROUNDS = ("tiny", "demo"), 1.02, 9
"""Cases of ``bench.before``, times the wall and the CPU time before, runs of each."""


def measure_small_cases(scale: Scale) -> list[Row]:
    """Compare whole commands on small cases with the commit before."""
    what = f"2 ranks, beside {BEFORE}, alternated"
    bound = f"not above {MOST_OF_BEFORE:g} times the wall and the CPU time"
    if scale.smoke:
        return [Row(what, bound, "measured on the cases themselves alone", True, judged_small=False)]
    found = {name: before.compare(name, ROUNDS, BEFORE) for name in SMALL}
    return [Row(f"{name}, {what}, {ROUNDS} runs of each", bound, cost.describe(),
                max(cost.wall, cost.cpu) <= MOST_OF_BEFORE, judged_small=False) for name, cost in found.items()]

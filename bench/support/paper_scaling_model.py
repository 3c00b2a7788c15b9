"""From counted runs to tables: what was measured, and what 1,000 ranks would take under stated assumptions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import log, log2
from typing import Any

CALLS, MESSAGES, BYTES, CPU = range(4)
KRYLOV_REDUCTIONS = 2
"""Reductions of PETSc's GMRES an iteration (classical Gram-Schmidt, norm), which Python does not see."""

LATENCY_S = 2e-6
BANDWIDTH = 10e9
NODE_RANKS = 64
DISK = 2e9
"""Assumed: seconds a message and a step of a reduction, bytes a second to a rank, ranks of a node, and bytes a second
that a node reads from and writes to the disk that all share."""

PER_RANK_PX = 10e6
ELEMENT = 31.0
"""The 10-gigapixel mosaic on 1,000 ranks: 10 Mpx and 31-px Q4 a rank, one subdomain each."""

MODEL_RANKS = (64, 256, 1000)
GAUSS_NEWTON = 3
PIXEL_PHASES = ("start", "read", "assemble", "independent start", "residual", "finish", "write")
START_S = 1e-10
"""CPU seconds a pixel of the rank that seeks the start, for what it deals out and puts together of finer levels'
grids: 0.095 s of a gigapixel, measured. The counted runs are too small to tell."""
SET_UP_EXPONENT = 1.5
"""Of the work of a subdomain's factor and of its interface over its unknowns: nested dissection's."""


@dataclass(frozen=True)
class Column:
    """One column of a table: its head and a value for each row's name."""

    head: str
    values: dict[str, str]


def table(title: str, columns: Sequence[Column]) -> str:
    """A Markdown table, rows in the order of the first column."""
    lines = [f"\n{title}\n", "| | " + " | ".join(c.head for c in columns) + " |", "|---" * (len(columns) + 1) + "|"]
    lines += [f"| {row} | " + " | ".join(c.values.get(row, "") for c in columns) + " |" for row in columns[0].values]
    return "\n".join(lines)


def entry(record: dict[str, Any], phases: Iterable[str], kinds: Iterable[str], column: int,
          ranks: str = "largest") -> float:
    """Sum over phases and kinds of a booked number, of the rank with most of it (or "mean", "rank_0")."""
    return float(sum(e[ranks][column] for e in record["entries"] if e["phase"] in phases and e["kind"] in kinds))


def per_krylov(record: dict[str, Any], kinds: Iterable[str], column: int) -> float:
    """A booked number of the linear steps an iteration of the Krylov solver."""
    return float(entry(record, ("linear step",), kinds, column) / max(sum(record["krylov_iterations"]), 1))


def all_phases(record: dict[str, Any]) -> list[str]:
    """Names of the phases of a record."""
    return sorted({e["phase"] for e in record["entries"]})


def measured_table(title: str, runs: Sequence[dict[str, Any]]) -> str:
    """Work, messages and bytes of a rank, as counted."""
    return table(f"{title}; numbers of the rank with most, iteration = of the Krylov solver, step = of Gauss-Newton",
                 [_measured(r) for r in runs])


def _measured(record: dict[str, Any]) -> Column:
    steps = record["iterations"]
    phases = all_phases(record)
    exchange = ("exchange",)
    linear = ("linear step",)

    def milli(seconds: float) -> str:
        return f"{1e3 * seconds:.1f}"

    return Column(record["case"].partition("_")[2].replace("_", " ranks, "), {
        "wall time, s": f"{record['wall_s']:.2f}",
        "unknowns": f"{record['n_dofs']}",
        "interface unknowns": f"{record['n_interface']}",
        "Gauss-Newton steps": f"{steps}",
        "Krylov iterations": "+".join(map(str, record["krylov_iterations"])),
        "read, CPU ms": milli(entry(record, ("read",), ("together",), CPU)),
        "M_s, Kbar_s, CPU ms": milli(entry(record, ("assemble",), ("together",), CPU)),
        "factors, CPU ms": milli(entry(record, ("factorize",), ("together",), CPU)),
        "interface set-up, CPU ms": milli(entry(record, ("interface set-up",), ("together",), CPU)),
        "residual, CPU ms a step": milli(entry(record, ("residual",), ("together",), CPU) / steps),
        "S_s and P_s, CPU ms an iteration": f"{1e3 * per_krylov(record, ('S_s', 'P_s'), CPU):.2f}",
        "neighbour exchanges an iteration": f"{per_krylov(record, exchange, CALLS):.1f}",
        "messages received in an exchange": f"{_ratio(record, linear, exchange, MESSAGES):.1f}",
        "bytes received in an exchange": f"{_ratio(record, linear, exchange, BYTES):.0f}",
        "small reductions an iteration, Python's": f"{per_krylov(record, ('allreduce',), CALLS):.1f}",
        "all-gathers a step": f"{entry(record, ('residual', 'linear step'), ('allgather',), CALLS) / steps:.1f}",
        "bytes of them a step": f"{entry(record, ('residual', 'linear step'), ('allgather',), BYTES) / steps:.0f}",
        "coarse unknowns": f"{record.get('coarse_vectors', 0)}",
        "CPU ms of one rank alone": milli(_alone(record)),
        "bytes that one rank deals out": f"{entry(record, phases, ('scatter',), BYTES):.0f}",
        "bytes that one rank gathers": f"{_to_root(record):.0f}",
        "of these for the result file": f"{entry(record, ('write',), ('message', 'gather'), BYTES):.0f}",
        "memory of a rank, MiB": f"{max(record['memory_bytes']) / 2**20:.0f}",
    })


def _ratio(record: dict[str, Any], phases: Iterable[str], kinds: Iterable[str], column: int) -> float:
    return entry(record, phases, kinds, column) / max(entry(record, phases, kinds, CALLS), 1)


def _alone(record: dict[str, Any]) -> float:
    """CPU seconds that one rank spends while others wait: on rank 0, and in mesh and start where one has more."""
    return find_root_work(record) + find_uneven_work(record)


def find_root_work(record: dict[str, Any]) -> float:
    """CPU seconds of rank 0 alone, once the case is read and checked."""
    phases = [p for p in all_phases(record) if p != "checks"]
    return entry(record, phases, ("on rank 0",), CPU, "rank_0")


def find_uneven_work(record: dict[str, Any]) -> float:
    """CPU seconds that one rank spends in mesh and start more than another."""
    most, least = (entry(record, ("mesh", "start"), ("together",), CPU, which) for which in ("largest", "smallest"))
    return most - least


def _to_root(record: dict[str, Any]) -> float:
    return entry(record, all_phases(record), ("gather", "message"), BYTES)


def coarse_table(runs: Sequence[dict[str, Any]]) -> str:
    """The coarse problem as it grows."""
    return table("Measured: coarse problem, one rank, subdomains of 10 x 10 Q4, l_c = 4 H", [
        Column(f"{r['n_subdomains']} subdomains", {
            "Krylov iterations": "+".join(map(str, r["krylov_iterations"])),
            "coarse unknowns": f"{r['coarse_vectors']}",
            "coarse unknowns a subdomain": f"{r['coarse_vectors'] / r['n_subdomains']:.0f}",
            "non-zeros": f"{r['coarse_nonzeros']:.2e}",
            "non-zeros a row": f"{r['coarse_nonzeros'] / r['coarse_vectors']:.0f}",
            "factorisation, CPU s": f"{r['coarse_factor_cpu_s']:.2f}",
            "one correction, CPU ms": f"{1e3 * _correction(r):.1f}",
            "memory of the rank, GiB": f"{max(r['memory_bytes']) / 2**30:.2f}"}) for r in runs])


def _correction(record: dict[str, Any]) -> float:
    return _ratio(record, ("linear step",), ("coarse correction",), CPU)


def build_models(runs: Sequence[dict[str, Any]], many: Sequence[dict[str, Any]],
                 rates: dict[str, Any]) -> list[Model]:
    """Weak scaling to each of MODEL_RANKS, from the smallest and the largest runs and coarse problems."""
    if len(runs) < 2 or len(many) < 2:
        raise RuntimeError("too few runs for a model: weak ones with two numbers of ranks, and coarse ones, come first")
    two_level = sorted((r for r in runs if "coarse_vectors" in r), key=lambda r: int(r["n_ranks"]))
    exponent = log(many[-1]["coarse_factor_cpu_s"] / many[0]["coarse_factor_cpu_s"]) / log(
        many[-1]["coarse_vectors"] / many[0]["coarse_vectors"])
    return [Model(n, two_level[0], two_level[-1], many[-1], exponent, rates) for n in MODEL_RANKS]


def model_table(models: Sequence[Model]) -> str:
    """Sizes, and seconds of a whole measurement."""
    return table(f"Model, not measured: {PER_RANK_PX / 1e6:g} Mpx, {ELEMENT:g}-px Q4 and one subdomain a rank, "
                 f"{GAUSS_NEWTON} Gauss-Newton steps, two levels",
                 [Column(f"{m.n_ranks} ranks, {m.n_ranks * PER_RANK_PX / 1e9:.2g} Gpx", m.sizes() | m.tell_seconds())
                  for m in models])


@dataclass(frozen=True)
class Model:
    """Weak scaling to n_ranks.

    few, run: counted runs with the fewest and the most ranks; coarse: the largest coarse problem;
    exponent: of the factorisation's time over the coarse unknowns;
    rates: the run whose CPU seconds a pixel count.
    """

    n_ranks: int
    few: dict[str, Any]
    run: dict[str, Any]
    coarse: dict[str, Any]
    exponent: float
    rates: dict[str, Any]

    @property
    def dofs(self) -> float:
        """Unknowns of a rank."""
        return 2 * PER_RANK_PX / ELEMENT**2

    @property
    def iterations(self) -> int:
        """Krylov iterations of the whole measurement, as on the largest run."""
        return sum(self.run["krylov_iterations"])

    @property
    def coarse_unknowns(self) -> float:
        """As many a subdomain as in the largest coarse problem, where all have neighbours."""
        return self.n_ranks * float(self.coarse["coarse_vectors"]) / float(self.coarse["n_subdomains"])

    def grown(self, value: Callable[[dict[str, Any]], float], by: str) -> float:
        """A number that grows with a size of the problem, on the straight line through both runs.

        What falls from one to the other stays as it is in the larger one.
        """
        slope = (value(self.run) - value(self.few)) / (self.run[by] - self.few[by])
        wanted = {"n_dofs": self.dofs, "n_pixels": PER_RANK_PX, "n_ranks": 1.0}[by] * self.n_ranks
        return float(value(self.run) + max(slope, 0.0) * (wanted - self.run[by]))

    def dealt(self) -> float:
        """Bytes that rank 0 deals out."""
        return self.grown(lambda r: entry(r, all_phases(r), ("scatter",), BYTES), "n_dofs")

    def gathered(self, *, result: bool) -> float:
        """Bytes that rank 0 receives, for the result file (mostly residual image) or before (by unknowns)."""
        kinds = ("gather", "message")
        if result:
            return self.grown(lambda r: entry(r, ("write",), kinds, BYTES), "n_pixels")
        return self.grown(lambda r: entry(r, set(all_phases(r)) - {"write"}, kinds, BYTES), "n_dofs")

    def exchange(self) -> tuple[float, float, float]:
        """Exchanges an iteration, messages and bytes of each; bytes grow with the side of a subdomain."""
        phase, kind = ("linear step",), ("exchange",)
        longer = self.dofs**0.5 / (self.run["n_dofs"] / self.run["n_ranks"]) ** 0.5
        return (per_krylov(self.run, kind, CALLS), _ratio(self.run, phase, kind, MESSAGES),
                _ratio(self.run, phase, kind, BYTES) * longer)

    def reductions(self) -> float:
        """Reductions an iteration."""
        return per_krylov(self.run, ("allreduce",), CALLS) + KRYLOV_REDUCTIONS

    def sizes(self) -> dict[str, str]:
        """Sizes, messages and bytes."""
        calls, messages, n_bytes = self.exchange()
        a_row = self.coarse["coarse_nonzeros"] / self.coarse["coarse_vectors"]
        return {
            "unknowns": f"{self.dofs * self.n_ranks:.3g}",
            "Krylov iterations, as on the largest run": f"{self.iterations}",
            "messages to a rank an iteration": f"{calls * messages:.0f}",
            "bytes to a rank an iteration": f"{calls * n_bytes:.0f}",
            "reductions an iteration": f"{self.reductions():.1f}",
            "coarse unknowns": f"{self.coarse_unknowns:.3g}",
            "non-zeros of the coarse matrix": f"{self.coarse_unknowns * a_row:.3g}",
            "exponent of its factorisation's time, fitted": f"{self.exponent:.2f}",
            "bytes that one rank deals out": f"{self.dealt():.3g}",
            "bytes that one rank gathers before the result": f"{self.gathered(result=False):.3g}",
            "bytes that one rank gathers for the result": f"{self.gathered(result=True):.3g}",
        }

    def tell_seconds(self) -> dict[str, str]:
        """Seconds of a whole measurement by kind of work, and of all."""
        found = self.seconds()
        return {f"{name}, s": f"{value:.2g}" for name, value in {**found, "all": sum(found.values())}.items()}

    def seconds(self) -> dict[str, float]:
        """Seconds of a whole measurement by kind of work."""
        calls, messages, n_bytes = self.exchange()
        larger = self.coarse_unknowns / self.coarse["coarse_vectors"]
        gathers = self.grown(lambda r: entry(r, ("residual", "linear step"), ("allgather",), BYTES) / r["iterations"],
                             "n_ranks")
        return {
            "pixels": self._pixels(),
            "local factors and interface set-up": self._set_up(),
            "local solves": self.iterations * self._local(),
            "neighbour exchange": self.iterations * calls * (messages * LATENCY_S + n_bytes / BANDWIDTH),
            "reductions": self.iterations * self.reductions() * 2 * log2(self.n_ranks) * LATENCY_S,
            "all-gathers of sums": GAUSS_NEWTON * gathers / BANDWIDTH,
            "coarse factorisation on one core": self.coarse["coarse_factor_cpu_s"] * larger**self.exponent,
            "coarse corrections on one core": self.iterations * self._corrections() * _correction(self.coarse)
            * larger * log2(self.coarse_unknowns) / log2(self.coarse["coarse_vectors"]),
            "one rank alone": self.grown(_alone, "n_dofs") + START_S * PER_RANK_PX * self.n_ranks,
            "dealing out and gathering at one rank": (self.dealt() + self.gathered(result=False)
                                                     + self.gathered(result=True)) / BANDWIDTH,
            "reading both images": NODE_RANKS * 2 * PER_RANK_PX / DISK,
            "writing the result": NODE_RANKS * PER_RANK_PX * self._result_bytes() / DISK,
        }

    def _pixels(self) -> float:
        """CPU seconds of a rank on its pixels; those of the rates are of all ranks and all pixels."""
        own = {p: self.rates["cpu_seconds"].get(p, 0.0) / self.rates["n_pixels"] * PER_RANK_PX for p in PIXEL_PHASES}
        own["residual"] *= GAUSS_NEWTON / self.rates["iterations"]
        return float(sum(own.values()))

    def _result_bytes(self) -> float:
        """Bytes of the result a pixel: nearly all are the residual image's."""
        return float(self.rates["result_bytes"] / self.rates["n_pixels"])

    def _set_up(self) -> float:
        """CPU seconds of a rank's factor and interface."""
        before = self.run["n_dofs"] / self.run["n_ranks"]
        measured = entry(self.run, ("factorize", "interface set-up"), ("together",), CPU)
        return float(measured * (self.dofs / before) ** SET_UP_EXPONENT)

    def _local(self) -> float:
        """CPU seconds of a rank's S_s and P_s an iteration; a solve with n unknowns costs n log n."""
        before = self.run["n_dofs"] / self.run["n_ranks"]
        grown = self.dofs * log2(self.dofs) / (before * log2(before))
        return float(per_krylov(self.run, ("S_s", "P_s"), CPU) * grown)

    def _corrections(self) -> float:
        return per_krylov(self.run, ("coarse correction",), CALLS)

"""Constants of ddic's cost model, fitted to runs of bench/interface_solvers.py."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from scipy.optimize import nnls

from bench.support.tiled_texture import CELL
from ddic.solvers.step_costs import (
    LARGEST_ARRAYS,
    CostConstants,
    Factor,
    Growth,
    MatchingCosts,
    count_entries,
    count_operations,
    find_shared_boundary,
)

Record = dict[str, Any]
OF_RUN = ("n", "cut_off_wavelength", "n_ranks", "per_subdomain")
"""What runs that differ by their solver alone have in common."""
Measure = Callable[[Record], float]

NEEDED = [(solver, ranks, is_regularized) for is_regularized in (False, True)
          for solver, ranks in (("cholmod", (1,)), ("assembled", (1,)), ("assembled", (2,)),
                                ("conjugate_gradient", (1, 2)), ("scaled", (1, 2)))]
NEEDED += [("two_level", (1, 2), True)]
"""Solver, numbers of ranks of which one will do, and whether with regularization."""


def fit_constants(records: Sequence[Record]) -> CostConstants:
    """Fit all constants.

    Parameters
    ----------
    records : sequence of dict
        Of ``bench.interface_solvers``, all of squares or all of cubes: every solver that is named below, without and
        with regularization, several sizes, one and two ranks.

    Returns
    -------
    CostConstants
        Each pair of coefficients to the least relative squares that leave both positive, others medians.
    """
    solved = [r for r in records if r["outcome"] == "solved"]
    assembled, cg = _of(solved, "assembled"), _of(solved, "conjugate_gradient")
    scaled, two_level, matching = (_of(solved, name) for name in ("scaled", "two_level", "matching"))
    alone = [r for r in assembled if r["n_ranks"] == 1]
    whole = _of(solved, "cholmod")
    local_costs = _fit_local(whole, [*scaled, *two_level])
    local_solve = _median(r["solve_cpu"] / (r["n_dofs"] * _entries(r)) for r in whole)
    products = [_fit_product(cg, is_regularized=kind) for kind in (False, True)]
    system_memory, _ = _fit_pair([(r["n_dofs"] / r["n_ranks"], 1.0) for r in cg],
                                 [max(r["peak_memory_bytes"]) for r in cg])
    return CostConstants(
        system_memory=system_memory,
        whole=_by_kind(alone, lambda r: r["setup_cpu"], _memory),
        whole_solve=_median(r["solve_cpu"] / (r["n_dofs"] * _entries(r)) for r in alone),
        parallel_factor=_by_parallel(assembled),
        parallel_memory=_parallel_power(_regularized(assembled), _memory),
        local=local_costs,
        local_solve=local_solve,
        interface=_fit_interface(scaled, local_costs, has_arrays=True),
        sparse_interface=_fit_interface(scaled, local_costs, has_arrays=False),
        coarse_set_up=_fit_coarse(scaled, _regularized(two_level)),
        dual_product=_fit_dual_product([*scaled, *two_level], local_solve),
        one_level_iterations=_fit_pair([(1.0, _waves(r)) for r in scaled], [r["inexact_iterations"] for r in scaled]),
        two_level_iterations=_median(r["inexact_iterations"] for r in two_level),
        cg_set_up=_median(r["setup_cpu"] * r["n_ranks"] / r["n_dofs"] for r in cg),
        cg_product=(products[0][0], products[1][0]),
        cg_product_calls=(products[1][1], products[1][2]),
        cg_iterations=_median(r["inexact_iterations"] for r in cg if not r["cut_off_wavelength"]),
        cg_iterations_by_square=_median(r["inexact_iterations"] / _cells(r)**2 for r in _regularized(cg)),
        matching=_fit_matching(matching) if matching else None,
    )


def list_missing(records: Sequence[Record]) -> list[str]:
    """List what the constants cannot be fitted without.

    Parameters
    ----------
    records : sequence of dict
        Of ``bench.interface_solvers``.

    Returns
    -------
    list of str
        Solvers, numbers of ranks and wavelengths without a run; nothing where all are there.
    """
    solved = [r for r in records if r["outcome"] == "solved"]
    missing = []
    for solver, ranks, is_regularized in NEEDED:
        if not any(r["solver"] == solver and r["n_ranks"] in ranks and (r["cut_off_wavelength"] > 0) == is_regularized
                   for r in solved):
            kind = "with" if is_regularized else "without"
            missing.append(f"{solver} on {' or '.join(map(str, ranks))} ranks {kind} regularization")
    return missing


def _of(records: Iterable[Record], solver: str) -> list[Record]:
    return [r for r in records if r["solver"] == solver]


def _median(values: Iterable[float]) -> float:
    return _round(float(np.median(list(values))))


def _cells(record: Record) -> float:
    """Cut-off wavelength in cells."""
    return float(record["cut_off_wavelength"] / CELL)


def _waves(record: Record) -> float:
    """Cut-off wavelength over the side of a subdomain, as far as it matters."""
    along = record["n_subdomains"] ** (1 / _dim(record))
    return float(min(_cells(record) * along / record["n"], along))


def _dim(record: Record) -> int:
    """Of the mesh; runs were of squares alone before they said it."""
    return int(record.get("dim", 2))


def _own(record: Record) -> tuple[float, float]:
    """Unknowns of a subdomain, or of the whole for a method of the whole; and those of a rank's subdomains together."""
    if record["solver"] in ("cholmod", "assembled"):
        return record["n_dofs"], record["n_dofs"]
    n = record["n_dofs"] / record["n_subdomains"]
    return n, n * -(-record["n_subdomains"] // record["n_ranks"])


def _operations(record: Record) -> float:
    """Of a factor of a subdomain, or of the whole for a method of the whole, an unknown."""
    return count_operations(_own(record)[0], _dim(record))


def _entries(record: Record) -> float:
    """The same of its entries."""
    return count_entries(_own(record)[0], _dim(record))


def _memory(record: Record) -> float:
    """Bytes of the larger rank that came with the set-up and the steps."""
    pairs = zip(record["peak_memory_bytes"], record["before_setup_bytes"], strict=True)
    return float(max(peak - before for peak, before in pairs))


def _local_seconds(record: Record) -> float:
    return float(record["setup_cpu" if record["solver"] == "cholmod" else "factorize_cpu"])


def _fit(rows: Sequence[tuple[float, ...]], values: Sequence[float],
         scales: Sequence[float] | None = None) -> tuple[float, ...]:
    """Coefficients, none negative, with the least squares of what they are off, relative to the values or to others."""
    relative = np.maximum(values if scales is None else scales, 1e-12)
    found, _ = nnls(np.array(rows) / relative[:, None], np.array(values) / relative)
    return tuple(_round(value) for value in found)


def _fit_pair(rows: Sequence[tuple[float, float]], values: Sequence[float],
              scales: Sequence[float] | None = None) -> tuple[float, float]:
    constant, growing = _fit(rows, values, scales)
    return constant, growing


def _round(value: float) -> float:
    return float(f"{value:.2g}")


def _fit_local(whole: Sequence[Record], dual: Sequence[Record]) -> tuple[Factor, Factor]:
    """Cost of factors of all sizes; their memory is taken to be all of a subdomain's, as most of it is."""
    return _by_kind([*whole, *dual], _local_seconds, _memory)


def _fit_interface(scaled: Sequence[Record], local: tuple[Factor, Factor], *,
                   has_arrays: bool) -> tuple[Factor, Factor]:
    """Cost of S_s and its inverse; as arrays those of a subdomain whose whole boundary is shared."""
    chosen = [r for r in scaled if (_own(r)[0] <= LARGEST_ARRAYS[_dim(r)]) == has_arrays]

    def shared(record: Record) -> float:
        return find_shared_boundary(record["n_subdomains"], _dim(record)) if has_arrays else 1.0

    return _by_kind(chosen, lambda r: r["interface_cpu"] / shared(r),
                    lambda r: (_memory(r) - _factor_memory(r, local)) / shared(r))


def _factor_memory(record: Record, local: tuple[Factor, Factor]) -> float:
    _, total = _own(record)
    return total * local[record["cut_off_wavelength"] > 0].memory.evaluate(_entries(record))


def _fit_factor(records: Sequence[Record], seconds: Measure, memory: Measure) -> Factor:
    totals = [_own(r)[1] for r in records]
    operations = [(total, total * _operations(r)) for total, r in zip(totals, records, strict=True)]
    entries = [(total, total * _entries(r)) for total, r in zip(totals, records, strict=True)]
    return Factor(Growth(*_fit_pair(operations, [seconds(r) for r in records])),
                  Growth(*_fit_pair(entries, [memory(r) for r in records], [_memory(r) for r in records])))


def _by_kind(records: Sequence[Record], seconds: Measure, memory: Measure) -> tuple[Factor, Factor]:
    """Without and with regularization."""
    without = [r for r in records if r["cut_off_wavelength"] == 0]
    return (_fit_factor(without, seconds, memory),
            _fit_factor([r for r in records if r["cut_off_wavelength"] > 0], seconds, memory))


def _regularized(records: Sequence[Record]) -> list[Record]:
    return [r for r in records if r["cut_off_wavelength"] > 0]


def _by_parallel(records: Sequence[Record]) -> tuple[float, float]:
    """Power by which the seconds of a factor fall, without and with regularization."""
    without = [r for r in records if r["cut_off_wavelength"] == 0]
    return (_parallel_power(without, lambda r: r["setup_cpu"]),
            _parallel_power(_regularized(records), lambda r: r["setup_cpu"]))


def _parallel_power(records: Sequence[Record], measure: Measure) -> float:
    """Power of the number of ranks by which a quantity of a rank falls."""
    found = []
    for r in records:
        ones = [measure(one) for one in records if one["n_ranks"] == 1 and one["n_dofs"] == r["n_dofs"]]
        if r["n_ranks"] > 1 and ones:
            found.append(np.log(_median(ones) / measure(r)) / np.log(r["n_ranks"]))
    return float(np.clip(_median(found), 0.0, 1.0))


def _fit_coarse(scaled: Sequence[Record], two_level: Sequence[Record]) -> Growth:
    """What the coarse space adds to the set-up of the same subdomains."""
    rows, values = [], []
    for r in two_level:
        same = [one["interface_cpu"] for one in scaled if all(one[key] == r[key] for key in OF_RUN)]
        if same:
            _, total = _own(r)
            rows.append((total, total * _operations(r)))
            values.append(max(r["interface_cpu"] - _median(same), 1e-3))
    return Growth(*_fit_pair(rows, values))


def _fit_matching(matching: Sequence[Record]) -> MatchingCosts:
    shares = [r["n_dofs"] / r["n_ranks"] for r in matching]
    iterations = [max(r["inexact_iterations"], 1) for r in matching]
    return MatchingCosts(
        set_up=_median(r["setup_cpu"] / n for r, n in zip(matching, shares, strict=True)),
        iteration=Growth(*_fit_pair([(n, n * _cells(r)) for r, n in zip(matching, shares, strict=True)],
                                    [r["inexact_cpu"] / k for r, k in zip(matching, iterations, strict=True)])),
        n_iterations=_median(iterations),
        memory=_median(_memory(r) / n for r, n in zip(matching, shares, strict=True)))


def _fit_dual_product(records: Sequence[Record], local_solve: float) -> float:
    """Solves with A_s that an iteration is worth."""
    found = []
    for r in records:
        solve = local_solve * _own(r)[1] * _entries(r)
        found.append((r["inexact_cpu"] / solve - 1) / max(r["inexact_iterations"], 1))
    return _median(found)


def _fit_product(records: Sequence[Record], *, is_regularized: bool) -> tuple[float, ...]:
    """Seconds of an iteration of conjugate gradients: of an unknown of a rank, of the rank, and of each subdomain."""
    chosen = [r for r in records if (r["cut_off_wavelength"] > 0) == is_regularized]
    rows = [(r["n_dofs"] / r["n_ranks"], 1.0, -(-r["n_subdomains"] // r["n_ranks"])) for r in chosen]
    return _fit(rows, [r["inexact_cpu"] / max(r["inexact_iterations"], 1) for r in chosen])

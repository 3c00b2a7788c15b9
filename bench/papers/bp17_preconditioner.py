"""What the preconditioner of [BP17] and ddic's cost and save beside plain GMRES, on the interface problem of the beam.

The first linear step of Gauss-Newton, from nearly the exact displacement. Times are CPU seconds of one rank without
the factors of A_s, which all share; kinds alternate, medians count. Each count stands with the error that it left.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.papers.compared import UNKNOWN, Compared
from bench.support.first_step import Curve, FirstStep, find_error_curve, find_error_points, prepare_first_step
from bench.support.loaded_beam import PAPER_BEAM, SMALL_BEAM, prepare_beam
from bench.support.step_problem import ALONE
from ddic.case.loader import parse_case_text
from ddic.problem.linear_solver import choose_preconditioner
from ddic.solvers.dual.dual_step import DualSettings
from ddic.solvers.dual.preconditioner import Preconditioner, build_preconditioner
from ddic.solvers.petsc import PetscStack

PLACE = "[BP17, section 5.3]"

KINDS: tuple[Preconditioner, ...] = ("none", "paper", "scaled", "two_level")
NAMES = {"none": "no preconditioner", "paper": "block explicit inverse of [BP17]", "scaled": "scaled assembly",
         "two_level": "two levels"}

MOST_ITERATIONS, REPEATS = 5000, 3

LOOKS, CALLS = 100, 21
"""Points of a curve, about; calls of which the median time counts."""

LEAST_FEWER, LEAST_FASTER = 10, 4
"""The paper's: times fewer iterations, and times less time in all."""


@dataclass(frozen=True)
class Setting:
    """Cut-off wavelength, pixels, and tolerance of GMRES; whether ddic's default preconditioner is judged at them."""

    wavelength: float
    tolerance: float
    judged: bool


SETTINGS = Setting(150.0, 1e-3, judged=False), Setting(600.0, 1e-6, judged=True)


@dataclass(frozen=True)
class Spent:
    """What one preconditioner took.

    Attributes
    ----------
    iterations : int
        Of GMRES.
    error : float
        Displacement error that it left, relative to the one-domain correction.
    set_up, solve, of_iteration : float
        CPU seconds of its set-up, of the step, and of an iteration without what the step does before and after them.
    """

    iterations: int
    error: float
    set_up: float
    solve: float
    of_iteration: float

    @property
    def total(self) -> float:
        """CPU seconds in all."""
        return self.set_up + self.solve


def measure(folder: Path, *, smoke: bool) -> list[Compared]:
    """Measure all preconditioners at each setting, and draw how residual and error fall."""
    beam = SMALL_BEAM if smoke else PAPER_BEAM
    files = prepare_beam(beam, folder.parent / f"beam_{beam.width}")
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    found: list[Compared] = []
    for axes, setting in zip(figure.subplots(1, len(SETTINGS)), SETTINGS, strict=True):
        text = files.write_case(setting.wavelength, f'method = "dual"\nsubdomains = {beam.subdomains}')
        case = parse_case_text(text, folder / "case.toml")
        first = prepare_first_step(case, files.field)
        try:
            chosen = choose_preconditioner(ALONE, case, first.problem.subdomains)
            spent = measure_all(first, setting)
            ratio = compare_application(first)
            curves, n_interface = find_curves(first, setting, spent)
        finally:
            first.destroy()
        _draw(axes, setting, curves)
        words = (f"{beam.text}, {first.problem.region.n_field} unknowns, {n_interface} at interfaces, "
                 f"l_c = {setting.wavelength:g} px, GMRES to {setting.tolerance:g}")
        rows = list_rows(words, setting, spent, chosen)
        found += [*rows[:1], Compared(
            PLACE, f"{NAMES['paper']}: CPU time of an application beside a product by local solves", words, "+70 %",
            f"{100 * ratio:+.0f} %", "what it adds to an iteration whose product is Eq. 31, as in the paper; ddic's "
            "product is another, next lines"), *rows[1:]]
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(KINDS))
    figure.savefig(folder / "bp17_preconditioner_fig11.png", dpi=150)
    return found


def _settle(kind: Preconditioner, setting: Setting) -> DualSettings:
    return DualSettings(kind, setting.tolerance, MOST_ITERATIONS, recycle=False)


def measure_all(first: FirstStep, setting: Setting) -> dict[str, Spent]:
    """Measure each preconditioner in turn, some times."""
    runs: dict[str, list[Spent]] = {kind: [] for kind in KINDS}
    for _ in range(REPEATS):
        for kind in KINDS:
            runs[kind].append(_measure_once(first, _settle(kind, setting)))
    return {kind: Spent(spent[0].iterations, spent[0].error, median(s.set_up for s in spent),
                        median(s.solve for s in spent), median(s.of_iteration for s in spent))
            for kind, spent in runs.items()}


def _measure_once(first: FirstStep, settings: DualSettings) -> Spent:
    begin = time.process_time()
    step = first.create_step(settings)
    ready = time.process_time()
    ticks: list[float] = []
    step.ksp.setMonitor(lambda *_: ticks.append(time.process_time()))
    try:
        result = step.solve(first.q, first.b)
        end = time.process_time()
    finally:
        step.destroy()
    of_iteration = (ticks[-1] - ticks[0]) / max(result.krylov_iterations, 1)
    return Spent(result.krylov_iterations, first.measure_error(result.dq), ready - begin, end - ready, of_iteration)


def compare_application(first: FirstStep) -> float:
    """Divide the CPU time of an application of the paper's P by that of a product by local solves, as in Eq. 31."""
    with PetscStack() as stack:
        problem = stack.keep(first.create_interface())
        x, y = (stack.keep(problem.exchange.create_vector()) for _ in range(2))
        x.set(1.0)
        product = _time_calls(lambda: problem.operator.mult(None, x, y))
        preconditioner, _ = build_preconditioner(stack, problem, "paper", "auto")
        if preconditioner is None:
            raise RuntimeError("there is no preconditioner to time")
        context = preconditioner
        return _time_calls(lambda: context.apply(None, x, y)) / product


def _time_calls(call: Callable[[], None]) -> float:
    """Give the median CPU seconds of a call."""
    seconds = []
    for _ in range(CALLS):
        begin = time.process_time()
        call()
        seconds.append(time.process_time() - begin)
    return median(seconds)


def find_curves(first: FirstStep, setting: Setting, spent: dict[str, Spent]) -> tuple[dict[str, Curve], int]:
    """Find how residual and error fall with each preconditioner, and the number of interface unknowns."""
    curves: dict[str, Curve] = {}
    for kind in KINDS[:-1]:
        every = max(spent[kind].iterations // LOOKS, 1)
        curves[kind], n_interface = find_error_curve(first, _settle(kind, setting), every)
    digits = range(1, 1 - round(np.log10(setting.tolerance)))
    curves[KINDS[-1]] = find_error_points(first, _settle(KINDS[-1], setting), [10.0**-k for k in digits])
    return curves, n_interface


def list_rows(text: str, setting: Setting, spent: dict[str, Spent], chosen: str) -> list[Compared]:
    """List what each preconditioner took beside none."""
    none = spent["none"]
    found = [Compared(PLACE, NAMES["none"], text, UNKNOWN,
                      f"{_count(none)}; {none.solve:.1f} s")]
    for kind in KINDS[1:]:
        one = spent[kind]
        is_judged = setting.judged and kind == chosen
        name = f"{NAMES[kind]}{', the default' if kind == chosen else ''}"
        fewer, faster = none.iterations / max(one.iterations, 1), none.total / one.total
        found += [
            Compared(PLACE, f"{name}: times fewer iterations", text, "10", f"{fewer:.1f}: {_count(one)}",
                     _explain(kind), f"at least {LEAST_FEWER}" if is_judged else "",
                     not is_judged or fewer >= LEAST_FEWER),
            Compared(PLACE, f"{name}: CPU time of an iteration beside none", text, "+70 %",
                     f"{100 * (one.of_iteration / none.of_iteration - 1):+.0f} %: {1e3 * one.of_iteration:.1f} ms, "
                     f"none {1e3 * none.of_iteration:.1f} ms", _explain(kind, _describe_iteration(kind))),
            Compared(PLACE, f"{name}: times less CPU time in all", text, "4", f"{faster:.1f}: {one.set_up:.1f} + "
                     f"{one.solve:.1f} s, none {none.total:.1f} s",
                     _explain(kind, "set-up + step, without the factors of A_s"),
                     f"at least {LEAST_FASTER}" if is_judged else "", not is_judged or faster >= LEAST_FASTER)]
    return found


def _explain(kind: str, *more: str) -> str:
    """Say of a preconditioner that is not in the paper that it is not, then more."""
    other = () if kind == "paper" else ("not in the paper, whose numbers are of its block explicit inverse",)
    return "; ".join((*other, *more))


def _describe_iteration(kind: str) -> str:
    """Say why an iteration costs what it does."""
    held = ("S_s, which the inverse needs, is kept and read for products in place of a local solve; plain GMRES "
            "orthogonalises against more vectors")
    return f"{held}; a second product and a coarse solve are added" if kind == "two_level" else held


def _count(spent: Spent) -> str:
    return f"{spent.iterations} iterations, which leave a displacement error of {spent.error:.1e}"


def _draw(axes: Axes, setting: Setting, curves: dict[str, Curve]) -> None:
    """Residual, dashed, and displacement error over iterations."""
    for number, (kind, curve) in enumerate(curves.items()):
        colour, at = f"C{number}", [1 + iteration for iteration, _, _ in curve]
        axes.loglog(at, [error for *_, error in curve], colour, label=NAMES[kind])
        axes.loglog(at, [residual for _, residual, _ in curve], colour, linestyle="--", linewidth=0.8)
    axes.set(xlabel="1 + GMRES iteration", ylabel="displacement error; residual (dashed)",
             title=f"l_c = {setting.wavelength:g} px, to {setting.tolerance:g}")
    axes.grid(alpha=0.3)

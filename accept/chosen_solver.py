"""Is what solver.method = "auto" chooses as fast as the best method that could be stated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_run, images

BOUND = 1.25
"""Largest time of "auto" over that of the best method."""

SIZES, WAVELENGTHS = (1000, 2000, 3000, 4000), (0, 80, 256)
"""Sides of the images and cut-off wavelengths, pixels; 0: no regularization."""

SMOKE_SIZES, SMOKE_WAVELENGTHS = (300,), (80,)
ELEMENT, EDGE = 10, 20
"""Side of an element, and what is left out at the images' edges, pixels."""

SIZE_ALONE = 2000
"""Side of the images that one rank measures as well, pixels."""

SIDE = 40
"""Elements along a side of the subdomains of which the dual method is given many."""

ROUNDS = 3
"""Runs of each method, one after the other in turn."""

HOPELESS = 2.0
"""Times the time of "auto" beyond which a method is not run again."""


@dataclass(frozen=True)
class SolvedCase:
    """A case whose linear steps are solved in several ways.

    Attributes
    ----------
    size : int
        Side of its images, pixels.
    wavelength : int
        Cut-off wavelength, pixels; 0: no regularization.
    n_ranks : int
        MPI ranks.
    folder : Path
        Where its images are, below ``images_SIZE``.
    """

    size: int
    wavelength: int
    n_ranks: int
    folder: Path

    def list_methods(self) -> dict[str, str]:
        """List the ways by name: what they add to the case file."""
        n_cells = ((self.size - 2 * EDGE) // ELEMENT) ** 2
        many = max(-(-n_cells // SIDE**2), self.n_ranks)
        methods = {"auto": "", "conjugate_gradient": 'method = "conjugate_gradient"\n',
                   "assembled": 'method = "assembled"\n', "dual": 'method = "dual"\n'}
        if many > self.n_ranks:
            methods["dual, many subdomains"] = f'method = "dual"\nsubdomains = {many}\n'
        return methods

    def write(self, solver: str) -> str:
        """Write the case file."""
        end = self.size - EDGE
        given = f"[regularization]\ncut_off_wavelength = {self.wavelength}\n" if self.wavelength else ""
        return (f'[images]\nreference = "images_{self.size}/reference.tif"\n'
                f'deformed = "images_{self.size}/deformed.tif"\n[mesh.structured]\n'
                f"region = [{EDGE}, {EDGE}, {end}, {end}]\nelement_size = {ELEMENT}\n{given}[solver]\n{solver}")


def measure_choice(scale: Scale) -> list[Row]:
    """Measure every case with "auto" and with each method stated, in turn.

    Parameters
    ----------
    scale : Scale
        A smoke run takes small images, once.

    Returns
    -------
    list of Row
        One for each case.
    """
    sizes, wavelengths = (SMOKE_SIZES, SMOKE_WAVELENGTHS) if scale.smoke else (SIZES, WAVELENGTHS)
    folder = scale.folder("chosen_solver")
    cases = [SolvedCase(size, wavelength, 2, folder) for size in sizes for wavelength in wavelengths]
    cases += [SolvedCase(sizes[0] if scale.smoke else SIZE_ALONE, wavelength, 1, folder) for wavelength in wavelengths]
    for size in sizes:
        images("sinusoidal", "--size", f"{size}x{size}", "--noise", "2", folder=folder / f"images_{size}")
    return [_measure_case(case, 1 if scale.smoke else ROUNDS) for case in cases]


def _measure_case(case: SolvedCase, n_rounds: int) -> Row:
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in case.list_methods()}
    failed: set[str] = set()
    for _ in range(n_rounds):
        for name, solver in case.list_methods().items():
            if name in failed or _is_hopeless(runs, name):
                continue
            try:
                runs[name].append(_run(case, name, solver))
            except RuntimeError:
                # Most often conjugate gradients that do not converge: no rival.
                if name == "auto":
                    raise
                failed.add(name)
    seconds = {name: median(_seconds(run) for run in found) for name, found in runs.items() if found}
    best = min((name for name in seconds if name != "auto"), key=seconds.__getitem__)
    ratio = seconds["auto"] / seconds[best]
    taken = runs["auto"][0]
    listed = ", ".join(f"{name} {value:.2f}" for name, value in seconds.items())
    missing = f"; did not converge: {', '.join(sorted(failed))}" if failed else ""
    wavelength = f"l_c = {case.wavelength} px" if case.wavelength else "no regularization"
    return Row(f'"auto" against the best method: {case.size} x {case.size} px, {ELEMENT}-px Q4, {wavelength}, '
               f"{case.n_ranks} ranks: CPU seconds of a rank",
               f"<= {BOUND} times the best",
               f"{ratio:.2f} times {best} ({listed}{missing}); it took {taken['method']} on {taken['n_subdomains']} "
               "subdomains", ratio <= BOUND, judged_small=False)


def _run(case: SolvedCase, name: str, solver: str) -> dict[str, Any]:
    record = ddic_run(case.write(solver), case.folder, case.n_ranks, "run")
    append_result("chosen_solver_runs", {"size": case.size, "wavelength": case.wavelength, "name": name} | {
        key: record[key] for key in ("n_ranks", "method", "preconditioner", "n_subdomains", "iterations",
                                     "krylov_iterations", "seconds", "cpu_seconds", "peak_memory_bytes")})
    return record


def _seconds(record: Mapping[str, Any]) -> float:
    """CPU seconds of a rank, all phases: wall time means little where others compute."""
    return float(sum(record["cpu_seconds"].values()) / record["n_ranks"])


def _is_hopeless(runs: Mapping[str, Sequence[Mapping[str, Any]]], name: str) -> bool:
    """Whether a method's first run took far longer than that of "auto"."""
    return bool(runs[name]) and _seconds(runs[name][0]) > HOPELESS * _seconds(runs["auto"][0])

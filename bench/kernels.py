"""Pixel kernels, one core: right-hand side against plain C, left-hand side, prefilter; 4096 x 4096 px.

All are measured alternately in one process; rates are medians of CPU time and count the region's pixels.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial, reduce
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.support.c_kernel import PRECISIONS, TOLERANCES, compiled, right_hand_side, triad
from bench.support.rows import Row, append_result, main
from bench.support.runs import DATA
from bench.support.unstructured_mesh import write_unstructured_mesh
from ddic.functionals.correlation import Correlation, read_correlations
from ddic.images.binned import ArraySource
from ddic.images.spline import read_gradient, read_spline
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.images.window import Window
from ddic.io.mesh_file import read_mesh
from ddic.mesh.mesh import Mesh, Similarity
from ddic.mesh.structured import build_structured_mesh
from ddic.partition.split import split_by_metis

SIZE, SMALL = 4096, 512
"""Side of the image, pixels; SMALL to see that everything runs."""

MARGIN = 32
"""Edge without elements, pixels."""

SUBDOMAIN = 160_000
"""Pixels of a subdomain in the paper's case: 29 megapixels in 180."""

ROUNDS = 5
RHS_BOUND, C_BOUND, LHS_BOUND = 100.0, 0.6, 70.0


@dataclass(frozen=True)
class Problem:
    """Parts of a mesh with their images and a displacement, and the pixels of all.

    windows: of the reference image, each of one part or shared by several.
    """

    name: str
    parts: list[Correlation]
    deformed: list[DeformedSubImage]
    q: list[NDArray[np.float64]]
    source: MaskedSource
    degree: int
    windows: list[Window]

    @property
    def n_pixels(self) -> int:
        """Pixels of the region."""
        return sum(part.n_usable_pixels for part in self.parts)


def field(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    """The reference field at nodes (n, 2), as unknowns (2 n,), pixels."""
    x, y = 2 * np.pi * nodes.T
    return np.column_stack([0.35 + 0.60 * np.sin(x / 1024 + 0.3) * np.cos(y / 1280 - 0.2),
                            -0.25 + 0.50 * np.cos(x / 1280 - 0.7) * np.sin(y / 1024 + 0.5)]).ravel()


def mixed_mesh(size: int) -> Mesh:
    """Make triangles and quadrangles of 15 px around a hole.

    Parameters
    ----------
    size : int
        Side of the image, pixels.

    Returns
    -------
    Mesh
        Kept in a file.
    """
    path = Path(DATA) / f"kernels_mixed_{size}.vtk"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        low, high = MARGIN + 0.3, size - MARGIN - 0.4
        write_unstructured_mesh(path, (low, low, high, high), 15.0, ((size / 2, size / 2), size / 8))
    return read_mesh(path, Similarity(), 2)


def build_problem(kind: Kind, size: int) -> Problem:
    """Cut a mesh in parts, as a run does.

    Parameters
    ----------
    kind : Kind
        Mesh, number of parts and spline.
    size : int
        Side of the image, pixels.

    Returns
    -------
    Problem
        With its images read.
    """
    mesh, degree = kind.mesh(size), kind.degree
    n_parts = max(2, round(size**2 / SUBDOMAIN)) if kind.cut else 1
    name = f"{kind.name}, {f'{n_parts} subdomains' if kind.cut else 'one part'}{', quintic' * (degree == 5)}"
    pixels = np.random.default_rng(0).integers(0, 256, (size, size), dtype=np.uint8)
    source = MaskedSource(ArraySource(Path("memory"), pixels, 255.0))
    labels = split_by_metis(mesh, n_parts) if n_parts > 1 else np.zeros(mesh.n_cells, dtype=np.int64)
    meshes = [mesh.create_submesh(np.flatnonzero(labels == s))[0] for s in range(n_parts)]
    groups = read_correlations(meshes, source, degree)
    parts, q = [part for group in groups for part in group], [field(m.nodes) for m in meshes]
    deformed = [image for group in groups for image in [DeformedSubImage(source, degree)] * len(group)]
    windows = [reduce(Window.union, (part.reference.window for part in group)) for group in groups]
    reach = [part.find_displaced_window(q_s) for part, q_s in zip(parts, q, strict=True)]
    for image in deformed:
        image.get_spline(reduce(Window.union, (r for r, of in zip(reach, deformed, strict=True) if of is image)))
    return Problem(name, parts, deformed, q, source, degree, windows)


def alternated(calls: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Median CPU seconds of each call, all called in turn ROUNDS times after one unmeasured call."""
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    for _ in range(ROUNDS):
        for name, call in calls.items():
            start = time.process_time()
            call()
            seconds[name].append(time.process_time() - start)
    return {name: float(np.median(values)) for name, values in seconds.items()}


def c_calls(p: Problem) -> dict[str, Callable[[], object]]:
    """The C kernel in each precision on all parts; raises RuntimeError where its sums are others."""
    calls: dict[str, Callable[[], object]] = {}
    for precision in PRECISIONS:
        library = compiled(precision)
        runs = []
        for part, deformed, q in zip(p.parts, p.deformed, p.q, strict=True):
            ours = part.compute_residual(deformed, q)
            run = right_hand_side(library, part, deformed.get_spline(part.find_displaced_window(q)),
                                  part.interpolation.monomial_coefficients(q))
            moments, sums = run()
            for a, b in ((moments, ours.moments[:, 0]), (sums, ours.cell_sums.values)):
                if not np.abs(a - b).max() <= TOLERANCES[precision] * np.abs(b).max():
                    raise RuntimeError(f"the C kernel's sums in {precision} differ from ours by more than rounding")
            runs.append(run)
        calls[f"C {precision}"] = partial(_run_all, runs)
    return calls


def _run_all(runs: Sequence[Callable[[], object]]) -> None:
    for run in runs:
        run()


def our_calls(p: Problem) -> dict[str, Callable[[], object]]:
    """Phases of a part's work, each on all parts."""
    return {
        "rhs": lambda: [part.compute_residual(g, q) for part, g, q in zip(p.parts, p.deformed, p.q, strict=True)],
        "hessian": lambda: [part.compute_cell_hessians() for part in p.parts],
        "gradient": lambda: [read_gradient(p.source.image, w, p.degree) for w in p.windows],
        "prefilter": lambda: [read_spline(p.source.image, w, p.degree) for w in p.windows],
    }


def rows_of(p: Problem) -> list[Row]:
    """Measure a problem and append its figures to bench/results/kernels_runs.jsonl."""
    stream = {"triad": triad(compiled("float64"))}
    seconds = alternated({**our_calls(p), **(c_calls(p) if p.degree == 3 else {}), **stream})
    rate = {name: p.n_pixels / s / 1e6 for name, s in seconds.items()}
    bandwidth = 24 * 4e6 / seconds["triad"] / 1e9
    lhs = 1.0 / (1.0 / rate["hessian"] + 1.0 / rate["gradient"])
    record = {
        "problem": p.name, "degree": p.degree, "n_pixels": p.n_pixels, "n_parts": len(p.parts),
        "rhs_mpx_per_s_core": rate["rhs"], "lhs_mpx_per_s_core": lhs, "hessian_mpx_per_s": rate["hessian"],
        "gradient_mpx_per_s": rate["gradient"], "prefilter_mpx_per_s": rate["prefilter"], "triad_gb_per_s": bandwidth}
    what = f"degree {p.degree}, {p.name}"
    left = Row(f"left-hand side, {what}", f">= {LHS_BOUND:.0f} Mpx/s per core" if p.degree == 3 else "recorded",
               f"{lhs:.0f} Mpx/s: gradient {rate['gradient']:.0f}, cell sums {rate['hessian']:.0f}; "
               f"prefilter of g {rate['prefilter']:.0f}", lhs >= LHS_BOUND or p.degree == 5, judged_small=False)
    if p.degree == 5:
        append_result("kernels", record)
        return [Row(f"right-hand side, {what}", "recorded", f"{rate['rhs']:.0f} Mpx/s", True, judged_small=False),
                left]
    in_c = {name: r for name, r in rate.items() if name.startswith("C ")}
    # Like with like: ddic computes in float64. What float32 would gain is shown beside.
    fraction, of_float32 = (rate["rhs"] / in_c[f"C {precision}"] for precision in ("float64", "float32"))
    append_result("kernels", {**record, **in_c, "rhs_fraction_of_c_kernel": fraction,
                              "rhs_fraction_of_c_kernel_float32": of_float32,
                              "c_kernel_bytes_per_triad_bytes": 16e-3 * in_c["C float64"] / bandwidth})
    return [Row(f"right-hand side, {what}", f">= {RHS_BOUND:.0f} Mpx/s per core and >= {C_BOUND} of C in float64",
                f"{rate['rhs']:.0f} Mpx/s, {fraction:.2f} of C's {in_c['C float64']:.0f} in float64, {of_float32:.2f} "
                f"of its {in_c['C float32']:.0f} in float32; C in float64 moves 16 B/px at "
                f"{16e-3 * in_c['C float64'] / bandwidth:.2f} of triad's {bandwidth:.0f} GB/s",
                rate["rhs"] >= RHS_BOUND and fraction >= C_BOUND, judged_small=False), left]


def square_mesh(size: int) -> Mesh:
    """Make Q4 of 16 px.

    Parameters
    ----------
    size : int
        Side of the image, pixels.

    Returns
    -------
    Mesh
        All but a margin.
    """
    return build_structured_mesh((MARGIN, MARGIN, size - MARGIN, size - MARGIN), 16)


@dataclass(frozen=True)
class Kind:
    """What a problem is made of.

    Attributes
    ----------
    name : str
        Of the mesh.
    mesh : callable
        Makes it for the side of an image in pixels.
    cut : bool
        Whether it is cut in subdomains.
    degree : int
        Of the spline.
    """

    name: str
    mesh: Callable[[int], Mesh]
    cut: bool
    degree: int


KINDS = (Kind("16-px Q4", square_mesh, False, 3), Kind("16-px Q4", square_mesh, True, 3),
         Kind("15-px T3/Q4", mixed_mesh, True, 3), Kind("16-px Q4", square_mesh, False, 5))


def rows_of_kind(number: int, size: int) -> list[Row]:
    """Build and measure one of KINDS.

    Parameters
    ----------
    number : int
        Which.
    size : int
        Side of the image, pixels.

    Returns
    -------
    list of Row
        Right-hand side and left-hand side.
    """
    return rows_of(build_problem(KINDS[number], size))


def measure(size: int = SIZE) -> list[Row]:
    """Measure all problems, each in a process of its own, as a run has: pages that others left are slower.

    Parameters
    ----------
    size : int
        Side of the image, pixels.

    Returns
    -------
    list of Row
        Two for each problem.
    """
    mixed_mesh(size)
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool:
        found = pool.map(partial(rows_of_kind, size=size), range(len(KINDS)))
        return [row for rows in found for row in rows]


if __name__ == "__main__":
    main("kernels_rows", measure)

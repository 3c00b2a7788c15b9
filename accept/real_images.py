"""Real and full-size pairs: the open-hole tension test, DIC Challenge 1.0 sample 14, what a full-size read costs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import integrate

from accept.support.settings import describe_settings
from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_run, images, real_data
from ddic.io.result_reader import read_result

DEGREE = 5
"""Of the spline."""

RANKS, SMOKE_RANKS = (1, 2, 4), (1, 2)
MOST_ITERATIONS, MOST_RESIDUAL, MOST_DIFFERENCE = 5, 2.35, 1e-8
"""Gauss-Newton iterations; standard deviation of the residual, grey levels; difference between rank counts, pixels."""

TIGHT = """[gauss_newton]
tolerance = 1e-10
rms_tolerance = 0
max_iterations = 200
[start]
from_result = "convergence_1.vtkhdf"
"""


def case_text(solver: str, extra: str = "", degree: int = DEGREE) -> str:
    """Give the case file of the pair.

    Parameters
    ----------
    solver : str
        Keys of ``[solver]``.
    extra : str
        Further sections.
    degree : int
        Of the spline.

    Returns
    -------
    str
        TOML text without ``[output]``.
    """
    folder = real_data() / "openhole"
    return f"""
[images]
reference = "{folder}/zoom-0053_1.tif"
deformed = "{folder}/zoom-0070_1.tif"
[mesh]
file = "{folder}/mesh_q4_pixels.msh"
[correlation]
spline_degree = {degree}
[solver]
method = "dual"
{solver}
{extra}"""


def measure_openhole(scale: Scale) -> list[Row]:
    """Measure iterations and residual after the multilevel start, and equality over rank counts."""
    folder, ranks = scale.folder("openhole"), SMOKE_RANKS if scale.smoke else RANKS
    return [_measure_convergence(folder, ranks), _compare_ranks(folder, ranks)]


def _measure_convergence(folder: Path, ranks: tuple[int, ...]) -> Row:
    case = case_text("subdomains = 8")
    summaries = [ddic_run(case, folder, n, f"convergence_{n}") for n in ranks]
    for summary in summaries:
        append_result("openhole_runs", summary)
    iterations = max(s["iterations"] for s in summaries)
    residual = max(s["residual_std_grey"] for s in summaries)
    cubic = ddic_run(case_text("subdomains = 8", degree=3), folder, 2, "convergence_cubic")
    return Row(f"openhole 53 -> 70, {describe_settings(case)}, 1, 2 and 4 ranks: iterations after the multilevel "
               "start, standard deviation of the residual",
               f"<= {MOST_ITERATIONS} iterations; <= {MOST_RESIDUAL} grey levels, correction stated",
               f"{iterations} iterations; {residual:.3f} grey levels, grey-level correction none, quintic spline "
               f"(cubic: {cubic['residual_std_grey']:.3f})",
               iterations <= MOST_ITERATIONS and residual <= MOST_RESIDUAL)


def _compare_ranks(folder: Path, ranks: tuple[int, ...]) -> Row:
    fields, case = [], case_text("subdomains = 8\ntolerance = 1e-12", TIGHT)
    for n in ranks:
        summary = ddic_run(case, folder, n, f"tight_{n}")
        append_result("openhole_runs", summary)
        fields.append(read_result(folder / f"tight_{n}.vtkhdf").displacement)
    difference = max(float(np.abs(field - fields[0]).max()) for field in fields[1:])
    return Row(f"openhole 53 -> 70, common start, {describe_settings(case)}, 1, 2 and 4 ranks: same field",
               f"<= {MOST_DIFFERENCE:.0e} px",
               f"largest difference {difference:.1e} px", difference <= MOST_DIFFERENCE)


ELEMENT, WAVELENGTH = 16, 48
"""Side of the elements and cut-off wavelength, pixels."""

BOUNDS = {"L1": (1, 0.005), "L3": (3, 0.02), "L5": (5, 0.02)}
"""Column of the exact values and largest RMS error in pixels, by amplitude law."""


def measure_sample14(scale: Scale) -> list[Row]:
    """Measure a row for each amplitude law: RMS of the column-averaged u over 32 <= x <= 2015."""
    folder = real_data() / "dic_challenge_sample14"
    exact = np.genfromtxt(folder / "exact_command.csv", delimiter=",", skip_header=0)
    rows = []
    for law, (column, bound) in list(BOUNDS.items())[: 1 if scale.smoke else None]:
        summary = ddic_run(f"""
[images]
reference = "{folder}/sample14_ref.tif"
deformed = "{folder}/sample14_{law}.tif"
[mesh.structured]
region = [16, 16, 2032, 576]
element_size = {ELEMENT}
[regularization]
cut_off_wavelength = {WAVELENGTH}
[solver]
method = "assembled"
""", scale.folder("sample14"), 2, law)
        columns, mean = column_average(scale.folder("sample14") / f"{law}.vtkhdf")
        x = np.arange(32, 2016)
        error = float(np.sqrt(((np.interp(x, columns, mean) - exact[x, column]) ** 2).mean()))
        append_result("sample14_runs", {"law": law, "rms_error_px": error, **summary})
        rows.append(Row(f"dic_challenge_sample14 {law}, {ELEMENT}-px Q4, l_c = {WAVELENGTH} px, method = "
                        '"assembled": column-averaged u, RMS',
                        f"<= {bound} px", f"{error:.4f} px", error <= bound))
    return rows


def column_average(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Average u over the columns of nodes of a structured mesh, by the trapezoidal rule.

    Parameters
    ----------
    path : Path
        Result file.

    Returns
    -------
    columns : (n,) array
        x of the columns, pixels.
    mean : (n,) array
        Mean of u over each, pixels.
    """
    result = read_result(path)
    columns, column = np.unique(result.mesh.nodes[:, 0], return_inverse=True)
    rows, row = np.unique(result.mesh.nodes[:, 1], return_inverse=True)
    u = np.empty((len(rows), len(columns)))
    u[row.reshape(-1), column.reshape(-1)] = result.displacement[:, 0]
    return columns, np.asarray(integrate.trapezoid(u, rows, axis=0)) / (rows[-1] - rows[0])


WIDTH, HEIGHT, SUBDOMAINS = 6576, 4384, 180
SMOKE_WIDTH, SMOKE_HEIGHT, SMOKE_SUBDOMAINS = 352, 256, 6
"""Of the images, pixels, and the number of subdomains."""


def measure_full_size(scale: Scale) -> list[Row]:
    """Run once; memory by rank and seconds by phase go to bench/results/full_size_runs.jsonl."""
    width, height, subdomains = ((SMOKE_WIDTH, SMOKE_HEIGHT, SMOKE_SUBDOMAINS) if scale.smoke
                                 else (WIDTH, HEIGHT, SUBDOMAINS))
    folder = images("sinusoidal", "--size", f"{width}x{height}", "--bit-depth", "16", folder=scale.folder("full_size"))
    case = f"""
[images]
reference = "{folder}/reference.tif"
deformed = "{folder}/deformed.tif"
[mesh.structured]
region = [32, 32, {width - 32}, {height - 32}]
element_size = 16
[regularization]
cut_off_wavelength = 64
[solver]
method = "dual"
subdomains = {subdomains}
"""
    summary = ddic_run(case, folder, 2)
    append_result("full_size_runs", summary)
    memory = ", ".join(f"{value / 2**20:.0f} MiB" for value in summary["peak_memory_bytes"])
    seconds = ", ".join(f"{name} {value:.1f}" for name, value in summary["seconds"].items())
    return [Row(f"4384 x 6576, 16-bit TIFF pair on 2 ranks, {describe_settings(case)}",
                "runs; memory by rank and seconds by phase recorded",
                f"{summary['n_dofs']} unknowns, {summary['iterations']} iterations; peak memory {memory}; "
                f"seconds: {seconds}", bool(summary["converged"]), judged_small=False)]

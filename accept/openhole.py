"""The real open-hole tension test, frames 53 -> 70: start, residual, and the same field on every rank count."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from accept.support.settings import describe_settings
from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_run, real_data
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


def measure(scale: Scale) -> list[Row]:
    """Measure iterations and residual after the multilevel start, and equality over rank counts.

    Parameters
    ----------
    scale : Scale
        A smoke run takes fewer rank counts.

    Returns
    -------
    list of Row
        Two rows.
    """
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

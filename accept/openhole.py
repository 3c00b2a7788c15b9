"""The real open-hole tension test, frames 53 -> 70: start, residual, and the same field on every rank count."""

from __future__ import annotations

import numpy as np
from bench.support.rows import Row, append_result, main
from bench.support.runs import DATA, ddic_run, real_data

from ddic.io.result_reader import read_result

DEGREE = 5
RANKS = (1, 2, 4)


def case(solver: str, extra: str = "") -> str:
    """The case file's text."""
    folder = real_data() / "openhole"
    return f"""
[images]
reference = "{folder}/zoom-0053_1.tif"
deformed = "{folder}/zoom-0070_1.tif"
[mesh]
file = "{folder}/mesh_q4_pixels.msh"
[correlation]
spline_degree = {DEGREE}
[solver]
{solver}
{extra}"""


def measure() -> list[Row]:
    """Two rows: iterations and residual after the multilevel start; equality over rank counts."""
    return [*_convergence(), *_equality()]


def _convergence() -> list[Row]:
    folder = DATA / "openhole"
    summaries = {}
    for ranks in RANKS:
        summaries[ranks] = ddic_run(case("subdomains = 8"), folder, ranks, f"convergence_{ranks}")
        append_result("openhole_runs", summaries[ranks])
    iterations = max(s["iterations"] for s in summaries.values())
    residual = max(s["residual_std_grey"] for s in summaries.values())
    cubic = ddic_run(case("subdomains = 8").replace(f"spline_degree = {DEGREE}", "spline_degree = 3"), folder, 2,
                     "convergence_cubic")
    return [Row("openhole 53 -> 70, no regularization, 1, 2 and 4 ranks: iterations after the multilevel start, "
                "standard deviation of the residual",
                "<= 5 iterations; <= 2.35 grey levels, correction stated",
                f"{iterations} iterations; {residual:.3f} grey levels, grey-level correction none, quintic spline "
                f"(cubic: {cubic['residual_std_grey']:.3f})", iterations <= 5 and residual <= 2.35)]


def _equality() -> list[Row]:
    folder = DATA / "openhole"
    tight = """[gauss_newton]
tolerance = 1e-10
rms_tolerance = 0
max_iterations = 200
[start]
from_result = "convergence_1.vtkhdf"
"""
    fields = []
    for ranks in RANKS:
        summary = ddic_run(case("subdomains = 8\ntolerance = 1e-12", tight), folder, ranks, f"tight_{ranks}")
        append_result("openhole_runs", summary)
        fields.append(read_result(folder / f"tight_{ranks}.vtkhdf").displacement)
    difference = max(float(np.abs(field - fields[0]).max()) for field in fields[1:])
    return [Row("openhole 53 -> 70, 8 METIS subdomains, common start, Krylov 1e-12, Gauss-Newton 1e-10, "
                "1, 2 and 4 ranks: same field", "<= 1e-8 px", f"largest difference {difference:.1e} px",
                difference <= 1e-8)]


if __name__ == "__main__":
    main("openhole", measure)

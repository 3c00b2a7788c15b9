"""DIC Challenge 1.0, sample 14: strain of growing spatial frequency, one mesh and cut-off wavelength for all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import integrate

from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_run, real_data
from ddic.io.result_reader import read_result

ELEMENT, WAVELENGTH = 16, 48
"""Side of the elements and cut-off wavelength, pixels."""

BOUNDS = {"L1": (1, 0.005), "L3": (3, 0.02), "L5": (5, 0.02)}
"""Column of the exact values and largest RMS error in pixels, by amplitude law."""


def measure(scale: Scale) -> list[Row]:
    """Measure a row for each amplitude law: RMS of the column-averaged u over 32 <= x <= 2015.

    Parameters
    ----------
    scale : Scale
        A smoke run takes one law.

    Returns
    -------
    list of Row
        RMS errors.
    """
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


"""The MPI part of ``accept.xdic``: prints a JSON line for each solver and regularization from rank 0.

Usage: xdic_job SIZE, the side of the images in pixels.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
from mpi4py import MPI

import ddic
from accept.support.opened_pair import render, straight_line

SLIP, ELEMENT, MARGIN, N_SUBDOMAINS = 0.6, 16, 20, 6
EXACT: dict[str, Any] = {"gauss_newton": {"tolerance": 1e-10, "rms_tolerance": 0, "largest_tolerance": 1e-8}}
LINEAR: dict[str, Any] = {"subdomains": N_SUBDOMAINS, "inexact": False, "tolerance": 1e-11}
REGULARIZATIONS: dict[str, dict[str, Any]] = {"none": {}, "64 px": {"regularization": {"cut_off_wavelength": 64}}}


def main(size: str) -> None:
    """Measure one pair by all solvers.

    Parameters
    ----------
    size : str
        Of the command line.
    """
    opened = straight_line(int(size), SLIP)
    pair = render(opened, int(size))
    side = ELEMENT * ((int(size) - 2 * MARGIN) // ELEMENT)
    mesh = ddic.structured_mesh((MARGIN, MARGIN, MARGIN + side, MARGIN + side), ELEMENT)
    points = np.random.default_rng(0).uniform(MARGIN, MARGIN + side, (5000, 2))
    for opening in ("both", "tangential"):
        for name, regularization in REGULARIZATIONS.items():
            fields = {}
            for method in ("assembled", "dual", "conjugate_gradient"):
                settings = {**EXACT, **regularization, "solver": {"method": method, **LINEAR},
                            "discontinuity": opened.sections(opening)}
                fields[method] = ddic.measure(pair, mesh, options=settings).at(points)
            for method in ("dual", "conjugate_gradient"):
                difference = float(np.nanmax(np.abs(fields[method] - fields["assembled"])))
                if MPI.COMM_WORLD.rank == 0:
                    print(json.dumps({"method": method, "opening": opening, "regularization": name,
                                      "ranks": MPI.COMM_WORLD.size, "difference_px": difference}), flush=True)


main(*sys.argv[1:])

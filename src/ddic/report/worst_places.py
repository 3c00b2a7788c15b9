"""Where the residual is worst."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ddic.io import result_schema as schema
from ddic.io.result_reader import Result

N_PLACES = 5
"""Places that are marked; more crowd the picture."""

APART = 0.08
"""Least distance of two of them, relative to the diagonal of the mesh: one bad spot is one place."""

EXCLUDED = {1: "excluded: no texture", 2: "excluded: it shows something else than the reference",
            3: "excluded: too few of its pixels are in both images"}


@dataclass(frozen=True)
class WorstPlace:
    """A cell with a large residual, the largest about.

    Attributes
    ----------
    number : int
        From 1, the worst.
    x, y : float
        Middle of the cell, pixels.
    residual_rms : float
        Grey levels.
    equivalent_error : float
        Displacement error that would leave this residual, pixels; nan where it is not known.
    verdict : str
        Doubtful, excluded, or nothing to complain about.
    """

    number: int
    x: float
    y: float
    residual_rms: float
    equivalent_error: float
    verdict: str


def find_worst_places(result: Result) -> list[WorstPlace]:
    """Find the cells with the largest residual, far from one another.

    Parameters
    ----------
    result : Result
        A measured field.

    Returns
    -------
    list of WorstPlace
        The worst first; at most 5.
    """
    if schema.RESIDUAL_RMS not in result.cell_data:
        return []
    centres, rms = result.mesh.centroids, result.cell_data[schema.RESIDUAL_RMS]
    nearest = APART * float(np.linalg.norm(np.ptp(result.mesh.nodes, axis=0)))
    chosen: list[int] = []
    for cell in np.argsort(-np.nan_to_num(rms, nan=-1.0), kind="stable"):
        if len(chosen) == N_PLACES or not np.isfinite(rms[cell]):
            break
        if all(np.linalg.norm(centres[cell] - centres[other]) >= nearest for other in chosen):
            chosen.append(int(cell))
    return [_describe(result, number, cell) for number, cell in enumerate(chosen, start=1)]


def _describe(result: Result, number: int, cell: int) -> WorstPlace:
    data, (x, y) = result.cell_data, result.mesh.centroids[cell]
    error = float(data[schema.EQUIVALENT_ERROR][cell]) if schema.EQUIVALENT_ERROR in data else float("nan")
    excluded = int(data[schema.EXCLUDED][cell]) if schema.EXCLUDED in data else 0
    doubtful = bool(data[schema.DOUBTFUL][cell]) if schema.DOUBTFUL in data else False
    verdict = EXCLUDED.get(excluded, "doubtful: the residual is that of a wrong displacement" if doubtful
                           else "not doubtful")
    return WorstPlace(number, float(x), float(y), float(data[schema.RESIDUAL_RMS][cell]), error, verdict)

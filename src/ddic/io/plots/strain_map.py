"""Maps of strain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.io import result_schema as schema
from ddic.io.plots.canvas import Limits
from ddic.io.plots.length_unit import PIXELS, LengthUnit
from ddic.io.plots.nodal_map import Values, draw_values
from ddic.io.plots.preview import Preview
from ddic.io.result_reader import Result
from ddic.kinematics.strain import compute_hencky, compute_von_mises_strain, find_principal_strains

Measure = Literal["infinitesimal", "green-lagrange", "hencky"]
MEASURES: tuple[Measure, ...] = ("infinitesimal", "green-lagrange", "hencky")
NUMBERS = ("xx", "yy", "xy", "principal-1", "principal-2", "von-mises")
"""What of a tensor is drawn."""

PANELS = ("xx", "yy", "xy")
"""What is drawn where nothing is asked for."""

NAMES = {"infinitesimal": "Strain", "green-lagrange": "Green-Lagrange strain", "hencky": "Logarithmic strain"}
SYMBOLS = {"xx": "xx", "yy": "yy", "xy": "xy", "principal-1": "1", "principal-2": "2", "von-mises": "vM"}
IN_THE_PLANE = [0, 1, 3]
"""Of XX, YY, ZZ, XY, YZ, XZ."""


@dataclass(frozen=True)
class StrainChoice:
    """Which strain is drawn.

    Attributes
    ----------
    measure : {"infinitesimal", "green-lagrange", "hencky"}
        The tensor.
    number : str or None
        One of NUMBERS; None for a panel each of xx, yy and xy.
    by_cell : bool
        As it was computed in the middle of cells, not as it was recovered at nodes.
    """

    measure: Measure = "infinitesimal"
    number: str | None = None
    by_cell: bool = False


def draw_strain(result: Result, choice: StrainChoice, unit: LengthUnit = PIXELS,
                limits: Limits | None = None, of_panels: Sequence[Limits] | None = None,
                image: Preview | None = None) -> Figure:
    """Draw strain on the mesh at rest.

    Parameters
    ----------
    result : Result
        With strains.
    choice : StrainChoice
        Which.
    unit : LengthUnit, optional
        Of the axes.
    limits : (float, float), optional
        Of the colours, no unit.
    of_panels : sequence of (float, float), optional
        Of the colours of each panel, in place of ``limits``.
    image : Preview, optional
        Drawn below.

    Returns
    -------
    Figure
        The page, or three panels.

    Raises
    ------
    InputError
        Where the result has no strain at nodes.
    """
    panels = list_strain_panels(result, choice)
    if of_panels is not None:
        panels = [replace(panel, limits=own) for panel, own in zip(panels, of_panels, strict=True)]
    return draw_values(result.mesh, panels, image, unit, limits)


def list_strain_panels(result: Result, choice: StrainChoice) -> list[Values]:
    """List what the panels of a strain map show.

    Parameters
    ----------
    result : Result
        With strains.
    choice : StrainChoice
        Which.

    Returns
    -------
    list of Values
        One, or three.

    Raises
    ------
    InputError
        Where the result has no strain at nodes.
    """
    tensors = pick_tensors(result, choice)
    numbers = PANELS if choice.number is None else (choice.number,)
    symbol = "E" if choice.measure == "green-lagrange" else r"\varepsilon"
    where = ", by cell" if choice.by_cell else ""
    panels = []
    for number in numbers:
        written = f"${symbol}_{{{SYMBOLS[number]}}}$"
        panels.append(Values(f"{NAMES[choice.measure]} {written}{where}", f"{written} [-]",
                             pick_number(tensors, number), choice.by_cell))
    return panels


def pick_tensors(result: Result, choice: StrainChoice) -> NDArray[np.float64]:
    """Pick the strain tensors of a result.

    Parameters
    ----------
    result : Result
        With strains.
    choice : StrainChoice
        Which.

    Returns
    -------
    (n_nodes, 3) or (n_cells, 3) array
        xx, yy, xy.

    Raises
    ------
    InputError
        Where the result has no strain at nodes.
    """
    if choice.by_cell:
        name = schema.STRAIN_INFINITESIMAL if choice.measure == "infinitesimal" else schema.STRAIN_GREEN_LAGRANGE
        tensors: NDArray[np.float64] = result.cell_data[name][:, IN_THE_PLANE]
        return compute_hencky(tensors) if choice.measure == "hencky" else tensors
    name = {"infinitesimal": schema.NODAL_INFINITESIMAL, "green-lagrange": schema.NODAL_GREEN_LAGRANGE,
            "hencky": schema.NODAL_HENCKY}[choice.measure]
    if name not in result.point_data:
        raise InputError(f"{result.path}: holds no strain at nodes (written before schema 1.6); add --by-cell, or run "
                         "ddic again")
    at_nodes: NDArray[np.float64] = result.point_data[name][:, IN_THE_PLANE]
    return at_nodes


def pick_number(tensors: NDArray[np.float64], number: str) -> NDArray[np.float64]:
    """Pick a component, a principal value or the equivalent strain of tensors.

    Parameters
    ----------
    tensors : (n, 3) array
        xx, yy, xy.
    number : str
        One of NUMBERS.

    Returns
    -------
    (n,) array
        No unit.
    """
    if number in PANELS:
        return tensors[:, PANELS.index(number)]
    if number == "von-mises":
        return compute_von_mises_strain(tensors)
    return find_principal_strains(tensors)[:, 0 if number == "principal-1" else 1]

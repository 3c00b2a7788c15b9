"""Pairs of which a part is spoilt: what is measured of the rest, and what is marked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ddic
from accept.support.spoilt_pair import BLURRED, BRIGHTNESS, HIDDEN, OTHERS, REGION, SpoiltPair, draw_clean
from accept.table import Scale
from bench.support.rows import Row, append_result

Array = NDArray[np.float64]

ELEMENT = 20
"""Side of the elements, pixels."""

WAVELENGTHS = (None, 80.0)
"""Cut-off wavelengths, pixels: without regularization and with."""

OF_FLOOR = 1.5
"""Largest RMS error, times that of the clean pair at the same nodes."""

HOPELESS = "motion blur of 15 px"
"""Leaves nodes up to 3 px off, and none that noise alone does not move by more than 0.15 px."""

MOST_HIDDEN = 0.5
"""Share of a cell's pixels that are hidden from which on it has to be marked."""


@dataclass(frozen=True)
class Found:
    """What a measurement of a spoilt pair came to.

    Attributes
    ----------
    ratio : float
        RMS error at the nodes of cells without a hidden pixel, relative to that of the clean pair there.
    rms, largest : float
        The error, pixels.
    n_unmarked : int
        Cells most of whose pixels are hidden that are not marked.
    n_lost : int
        Cells that are excluded though neither they nor a neighbour holds a hidden pixel.
    """

    ratio: float
    rms: float
    largest: float
    n_unmarked: int
    n_lost: int


def measure_brightness(scale: Scale) -> list[Row]:
    """Measure pairs whose light changes.

    Parameters
    ----------
    scale : Scale
        A smoke run takes one.

    Returns
    -------
    list of Row
        With and without regularization.
    """
    return _judge_all("light changes", BRIGHTNESS, scale)


def measure_hidden(scale: Scale) -> list[Row]:
    """Measure pairs of which a square is hidden.

    Parameters
    ----------
    scale : Scale
        A smoke run takes one.

    Returns
    -------
    list of Row
        With and without regularization.
    """
    return _judge_all("a square of the deformed image is hidden", HIDDEN, scale)


def measure_other_spoilt(scale: Scale) -> list[Row]:
    """Measure pairs with dirt on the lens, partly out of the image, or half blank.

    Parameters
    ----------
    scale : Scale
        A smoke run takes one.

    Returns
    -------
    list of Row
        With and without regularization.
    """
    return _judge_all("dirt, out of the image, blank", OTHERS, scale)


def _judge_all(what: str, cases: Mapping[str, Callable[[], SpoiltPair]], scale: Scale) -> list[Row]:
    rows = []
    for wavelength in WAVELENGTHS[-1:] if scale.smoke else WAVELENGTHS:
        options = _options(wavelength)
        told, holds = [], True
        for name in list(cases)[:1] if scale.smoke else cases:
            found = _measure(name, cases[name](), options)
            if isinstance(found, str):
                told.append(f"{name}: refused ({found})")
                holds = False
                continue
            good = found.ratio <= OF_FLOOR and found.n_unmarked == 0 and found.n_lost == 0
            holds &= good
            told.append(f"{name}: {found.ratio:.2f} times, largest {found.largest:.2f} px"
                        + ("" if good else f" (MISSED; {found.n_unmarked} not marked, {found.n_lost} lost)"))
        rows.append(Row(f"{what}, {_describe(wavelength)}", f"RMS error where the specimen is seen at most {OF_FLOOR} "
                        "times that of the clean pair, hidden cells marked, at most one row of neighbours lost",
                        "; ".join(told), holds))
    return rows


def measure_blur(scale: Scale) -> list[Row]:
    """Measure pairs whose deformed image is blurred by motion.

    Parameters
    ----------
    scale : Scale
        A smoke run takes the least blur.

    Returns
    -------
    list of Row
        With and without regularization.
    """
    rows = []
    for wavelength in WAVELENGTHS[-1:] if scale.smoke else WAVELENGTHS:
        told, holds = [], True
        for name in list(BLURRED)[:1] if scale.smoke else BLURRED:
            found = _measure(name, BLURRED[name](), _options(wavelength))
            holds &= isinstance(found, str) == (name == HOPELESS)
            told.append(f"{name}: " + (found if isinstance(found, str) else
                                       f"RMS {found.rms:.3f} px, {found.ratio:.1f} times, largest {found.largest:.1f}"))
        rows.append(Row(f"motion blur, {_describe(wavelength)}", f"converges, but {HOPELESS} is refused; reported",
                        "; ".join(told), holds))
    return rows


def _options(wavelength: float | None) -> dict[str, Any]:
    return {} if wavelength is None else {"regularization": {"cut_off_wavelength": wavelength}}


def _describe(wavelength: float | None) -> str:
    return "without regularization" if wavelength is None else f"l_c = {wavelength:g} px"


def _measure(name: str, pair: SpoiltPair, options: dict[str, Any]) -> Found | str:
    """Errors where the specimen is seen; a string where the measurement was refused."""
    mesh = ddic.structured_mesh(REGION, ELEMENT)
    clean = draw_clean()
    try:
        result = ddic.measure((pair.reference, pair.deformed), mesh, options=options)
    except ddic.DdicError as error:
        return str(error).splitlines()[0]
    at_rest = ddic.measure((clean.reference, clean.deformed), mesh, options=options)
    n_pixels, n_hidden = pair.count_hidden(mesh)
    cells = mesh.cells
    is_touched = n_hidden > 0
    seen = np.unique(cells[~is_touched])
    off = result.at(mesh.nodes)[seen] - pair.deformation.displacement(mesh.nodes[seen])
    floor = at_rest.at(mesh.nodes)[seen] - clean.deformation.displacement(mesh.nodes[seen])
    rms = float(np.sqrt(np.mean(off**2)))
    excluded = result.cell_data["excluded"] > 0
    marked = excluded | (result.cell_data["doubtful"] > 0)
    has_touched_neighbour = np.isin(cells, np.unique(cells[is_touched])).any(axis=1)
    found = Found(rms / float(np.sqrt(np.mean(floor**2))), rms, float(np.linalg.norm(off, axis=1).max()),
                  int(((n_hidden > MOST_HIDDEN * n_pixels) & ~marked).sum()),
                  int((excluded & ~has_touched_neighbour).sum()))
    append_result("start_runs", {"case": f"{name}, {options}", **vars(found)})
    return found


CHECKS: dict[str, Callable[[Scale], list[Row]]] = {
    "brightness": measure_brightness, "hidden": measure_hidden, "other_spoilt": measure_other_spoilt,
    "blur": measure_blur,
}

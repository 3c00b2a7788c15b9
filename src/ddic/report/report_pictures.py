"""The pictures of a report, as they stand in its page."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from ddic.io import result_schema as schema
from ddic.io.result_reader import Result
from ddic.plots.canvas import draw_failures, draw_marks, find_length_unit
from ddic.plots.curves import draw_corrections, draw_iterations, draw_krylov
from ddic.plots.deformed import draw_deformed
from ddic.plots.maps import (
    Preview,
    StrainChoice,
    draw_displacement,
    draw_strain,
    pick_number,
    pick_tensors,
    read_preview,
)
from ddic.plots.residual import draw_grey_histogram, draw_residual, draw_residual_histogram
from ddic.report.gathered import Gathered
from ddic.report.worst_places import WorstPlace

SHOWN_PERCENT = 99.5
"""Of the strains of nodes, those to either end of the colours."""

DPI = 110
"""Dots an inch: sharp on a screen, and some hundred kilobytes a picture."""


Drawing = tuple[str, str, Callable[[], Figure]]
"""Name, caption, and what draws it."""

Drawn = tuple[str, str, Figure]
"""Name, caption and page."""


@dataclass(frozen=True)
class EmbeddedFigure:
    """A picture in a page.

    Attributes
    ----------
    name : str
        What it shows, in a word.
    caption : str
        Below it.
    data : str
        Its PNG as a data URI.
    width, height : int
        Dots.
    """

    name: str
    caption: str
    data: str
    width: int
    height: int


def encode_report_figures(gathered: Gathered, places: Sequence[WorstPlace]) -> dict[str, list[EmbeddedFigure]]:
    """Draw all pictures that a result allows, for a page that holds them itself.

    Parameters
    ----------
    gathered : Gathered
        The result and what belongs to it.
    places : sequence of WorstPlace
        That are marked in the residual.

    Returns
    -------
    dict of list of EmbeddedFigure
        By section: fields, residual, convergence, histograms.
    """
    return {section: [_encode(name, caption, figure) for name, caption, figure in drawn]
            for section, drawn in draw_report_figures(gathered, places).items()}


def draw_report_figures(gathered: Gathered, places: Sequence[WorstPlace]) -> dict[str, list[Drawn]]:
    """Draw the figures of all pictures.

    Parameters
    ----------
    gathered : Gathered
        The result and what belongs to it.
    places : sequence of WorstPlace
        That are marked in the residual.

    Returns
    -------
    dict of list of (str, str, Figure)
        By section: name, caption and page of each.
    """
    previews = {name: read_preview(image) for name, image in gathered.images.items()}
    drawings: dict[str, list[Drawing]] = {
        "fields": _list_fields(gathered, previews.get("reference")),
        "residual": [("residual", _caption_residual(gathered), partial(_draw_marked_residual, gathered, places))],
        "convergence": _list_curves(gathered),
        "histograms": _list_histograms(gathered, previews),
    }
    drawn = {section: [(name, caption, draw()) for name, caption, draw in listed]
             for section, listed in drawings.items()}
    for of_section in drawn.values():
        for _, _, figure in of_section:
            draw_failures(figure, [gathered.result])
    return drawn


def _list_fields(gathered: Gathered, image: Preview | None) -> list[Drawing]:
    """Displacement and strain over the image, and the deformed mesh."""
    result, unit = gathered.result, find_length_unit(gathered.result)
    over = "over the reference image" if image is not None else "on the mesh; the reference image is not there"
    drawn: list[Drawing] = [
        (f"displacement {axis}", f"Displacement u_{axis} {over}.",
         partial(draw_displacement, result, image, axis, unit)) for axis in ("x", "y")]
    by_cell = schema.NODAL_INFINITESIMAL not in result.point_data
    where = "in the middle of elements" if by_cell else "at nodes"
    if not by_cell or schema.STRAIN_INFINITESIMAL in result.cell_data:
        drawn += [(f"strain {pair}", f"Infinitesimal strain {pair} {where}, {over}; colours end at the {SHOWN_PERCENT} "
                                     "% quantiles.",
                   partial(_draw_strain, result, StrainChoice("infinitesimal", pair, by_cell), image))
                  for pair in ("xx", "yy", "xy")]
    caption = "The deformed mesh without its rigid motion, amplified as the title says, over the mesh at rest."
    return [*drawn, ("deformed mesh", caption, partial(draw_deformed, result, unit=unit))]


def _draw_strain(result: Result, choice: StrainChoice, image: Preview | None) -> Figure:
    """Strain in colours that a few nodes at an edge do not decide."""
    values = pick_number(pick_tensors(result, choice), choice.number or "xx")
    known = values[np.isfinite(values)]
    limits = None
    if known.size:
        low, high = np.percentile(known, [100.0 - SHOWN_PERCENT, SHOWN_PERCENT])
        limits = (float(low), float(high)) if low < high else None
    return draw_strain(result, choice, find_length_unit(result), limits, image=image)


def _caption_residual(gathered: Gathered) -> str:
    what = "by pixel" if gathered.result.residual_image is not None else "by element (no residual image was written)"
    return (f"Correlation residual {what}. Even noise is what a good measurement leaves; the numbered places have the "
            "largest residuals.")


def _draw_marked_residual(gathered: Gathered, places: Sequence[WorstPlace]) -> Figure:
    unit = find_length_unit(gathered.result)
    figure = draw_residual(gathered.result, unit=unit)
    draw_marks(figure.axes[0], [(place.x, place.y) for place in places], unit.size)
    return figure


def _list_curves(gathered: Gathered) -> list[Drawing]:
    """Convergence of the displacement and of the linear step."""
    result = gathered.result
    drawn: list[Drawing] = []
    if len(result.gauss_newton.get("iteration", ())):
        drawn.append(("iterations", "Corrections of Gauss-Newton, and the residual before each of them.",
                      partial(draw_iterations, result.gauss_newton, gathered.noise_floor)))
    if len(result.corrections.get("correction", ())):
        drawn.append(("corrections", "Corrections of PGD-DIC.", partial(draw_corrections, result.corrections)))
    if any(len(history) for history in result.krylov):
        drawn.append(("Krylov iterations", "Convergence of the interface problem in each iteration.",
                      partial(draw_krylov, {"": result.krylov})))
    return drawn


def _list_histograms(gathered: Gathered, previews: dict[str, Preview]) -> list[Drawing]:
    drawn: list[Drawing] = []
    residual = gathered.result.residual_image
    if residual is not None:
        caption = "The residual beside a normal distribution: what stands above it in the tails is not noise."
        drawn.append(("residual histogram", caption, partial(draw_residual_histogram, residual)))
    if previews:
        pixels = {name: preview.pixels for name, preview in previews.items()}
        drawn.append(("grey-level histogram", "Grey levels of the images.", partial(draw_grey_histogram, pixels)))
    return drawn


def _encode(name: str, caption: str, figure: Figure) -> EmbeddedFigure:
    """A figure as a PNG within the page."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=DPI)
    width, height = (round(DPI * side) for side in figure.get_size_inches())
    data = base64.b64encode(stream.getvalue()).decode("ascii")
    return EmbeddedFigure(name, caption, f"data:image/png;base64,{data}", width, height)

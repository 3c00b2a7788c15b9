"""One picture of a result by its kind: what ``ddic plot``, ``Result.plot`` and the page draw."""

from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ddic.errors import InputError, refuse_unknown_arguments
from ddic.fracture.opening import get_lines, measure_openings
from ddic.io import result_schema as schema
from ddic.io.input_file import split_dataset
from ddic.io.result_reader import Result
from ddic.io.volume_file import hold_source
from ddic.plots import canvas, curves, maps
from ddic.plots.canvas import ColourScale
from ddic.plots.kinds import KINDS, NUMBERS, OF_VOLUMES, OVER_IMAGE
from ddic.plots.partition import draw_partition
from ddic.plots.slices import Below, Slices

OF_BOTH = ("difference", "krylov")
"""Kinds that show a second result too, where there is one."""


@dataclass(frozen=True)
class Look:
    """How a result is drawn.

    Attributes
    ----------
    component : {"x", "y", "z", "magnitude"}
        Of the displacement.
    strain : StrainChoice
        Of the strain.
    amplification : float or None
        Of the deformed mesh.
    unit : LengthUnit
        Of lengths.
    scale : ColourScale
        Of values.
    title : str or None
        In the place of what the picture says of itself; none where it is empty.
    scale_bar : float or None
        Length of a scale bar, in the unit; 0 for a round one, None for no bar.
    slices : tuple of (str, float)
        Axis and place, voxels, of each slice of a volume; empty for three through the middle of the mesh.
    """

    component: canvas.Component = "magnitude"
    strain: maps.StrainChoice = field(default_factory=maps.StrainChoice)
    amplification: float | None = None
    unit: canvas.LengthUnit = canvas.PIXELS
    scale: ColourScale = canvas.OF_VALUES
    title: str | None = None
    scale_bar: float | None = None
    slices: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class SharedScale:
    """What the frames of an animation have in common.

    Attributes
    ----------
    scales : sequence of ColourScale
        Of each panel.
    view : SharedView or None
        Of deformed meshes.
    """

    scales: Sequence[ColourScale]
    view: maps.SharedView | None


@dataclass(frozen=True)
class Drawing:
    """What is drawn.

    Attributes
    ----------
    result, other : Result
        What is shown, and a second one that it is compared with, or None.
    look : Look
        How.
    preview : Preview, tuple of Slice, or None
        Of the reference image, below it; of a volume its slices.
    line : tuple of float
        Ends of the line along which a curve is drawn, pixels: coordinates of the first, then of the second.
    """

    result: Result
    other: Result | None
    look: Look
    preview: Below = None
    line: tuple[float, ...] = ()

    @property
    def slices(self) -> Slices | None:
        """Those of a volume."""
        return self.preview if isinstance(self.preview, tuple) else None

    @cached_property
    def compared(self) -> maps.ComparedFields:
        """The displacement beside that of the second result."""
        return maps.compute_difference(self.result, self.other or self.result)


def find_lacking(result: Result, other: Result | None) -> dict[str, str]:
    """Find what cannot be drawn of a result, and of a second one to compare it with: the reason by kind."""
    points, has_products = result.point_data, result.separated is not None
    reasons = (
        (other is None, "difference", "--kind difference compares two results; give the second by --other"),
        (other is not None and other.mesh.dim != result.mesh.dim, "difference",
         "one result is of images, the other of volumes; give another --other"),
        (not _has_curves(result), "krylov", "holds no Krylov history (a direct method); choose another --kind"),
        (not get_lines(result), "opening", "was measured without discontinuities; choose another --kind"),
        (schema.SIGMA_DISPLACEMENT[0] not in points, "sigma",
         "holds no standard deviations; measure with output.uncertainty = true"),
        (schema.REGULARIZATION_BIAS not in points, "bias",
         "holds no bias of a regularization; measure with one and with output.uncertainty = true"),
        (schema.NORMALISED_DIFFERENCE not in points, "simulation",
         "was not compared with a simulation; run ddic compare or ddic identify"),
        (result.residual_extent is None, "histogram",
         "holds no residual image; measure with output.residual_image = true"),
        (result.path == Path(), "independent",
         "keeps one of the fields at shared nodes; open the file that the measurement wrote"),
        (schema.INDEPENDENT not in points, "independent",
         "holds no fields of subdomains by themselves; measure with output.independent_fields = true and "
         "solver.method = \"dual\""),
        (not result.detection, "detection", 'no line was looked for (discontinuity = "detect"); choose another --kind'),
        (schema.CAMERA not in result.cell_data, "near-far",
         "is of one camera (a case without [[near]]); choose another --kind"),
        (not has_products, "modes", "was not measured by PGD-DIC ([pgd]); choose another --kind"),
        (has_products and not len(result.corrections.get("correction", ())), "corrections",
         "took no correction; choose another --kind"),
        (not has_products, "corrections", "was not measured by PGD-DIC ([pgd]); choose another --kind"),
        *((result.mesh.dim == 3, kind, "is of volumes, whose deformed mesh ParaView shows (Warp By Vector); choose "
                                       "another --kind") for kind in ("deformed", "independent")),
    )
    # Of several reasons the last one.
    return {kind: reason for is_lacking, kind, reason in reasons if is_lacking}


def require_known(result: Result, look: Look) -> None:
    """Raise InputError where a plane result is asked for what only one of volumes has."""
    asked = [name for name in (look.component, look.strain.number) if name in OF_VOLUMES]
    asked += [f"slice {axis}={place:g}" for axis, place in look.slices]
    if asked and result.mesh.dim == 2:
        raise InputError(f"{result.path}: is of images and has no {asked[0]}, which is of volumes; leave it out")


def _has_curves(result: Result) -> bool:
    """Whether a result has a Krylov history."""
    return any(len(history) for history in result.krylov)


def find_image(result: Result, which: str = "reference") -> Path | None:
    """Find the reference or the deformed image that a result names; None where it names none, or it is gone."""
    named = str(result.attributes.get(schema.PROVENANCE, {}).get(f"{which}_path", ""))
    return Path(named) if named and is_there(Path(named)) else None


def is_there(path: Path) -> bool:
    """Tell whether an image or a volume, which may be a folder or an array in a file, is where a path says."""
    return split_dataset(path)[0].exists()


def draw(kind: str, drawing: Drawing, shared: SharedScale | None = None) -> Figure:
    """Draw one picture of a kind that the result allows; ``shared`` is of the frames of an animation."""
    figure = _draw_kind(kind, drawing, shared)
    look = drawing.look
    if look.scale_bar is not None:
        pictures = canvas.list_image_axes(figure)
        if drawing.slices is not None:
            # They have one scale: one bar will do, where there is most room.
            pictures = sorted(pictures, key=lambda axes: -float(np.ptp(axes.get_xlim())))[:1]
        for axes in pictures:
            canvas.draw_scale_bar(axes, look.unit, look.scale_bar or None)
    if look.title is not None:
        canvas.set_titles(figure, look.title)
    shown = [drawing.other] if kind in OF_BOTH and drawing.other is not None else []
    canvas.draw_failures(figure, [drawing.result, *shown])
    return figure


def _draw_kind(kind: str, drawing: Drawing, shared: SharedScale | None) -> Figure:
    result, preview, look = drawing.result, drawing.preview, drawing.look
    component, unit = look.component, look.unit
    scales, view = ((look.scale,), None) if shared is None else (shared.scales, shared.view)
    scale = scales[0]

    def draw_panels(panels: Sequence[maps.Values]) -> Figure:
        return maps.draw_values(result.mesh, panels, preview, unit, [scale] * len(panels))

    by_kind: dict[str, Callable[[], Figure]] = {
        "partition": lambda: draw_partition(result, preview, unit),
        "detection": lambda: curves.draw_detection(result, unit, scale),
        "independent": lambda: maps.draw_independent(result, component, look.amplification, unit, scale),
        "deformed": lambda: maps.draw_deformed(result, component, look.amplification, unit, scale, view),
        "displacement": lambda: maps.draw_displacement(result, preview, component, unit, scale),
        "strain": lambda: maps.draw_strain(result, look.strain, preview, unit, scales),
        "sigma": lambda: draw_panels(maps.list_sigma_panels(result, component, look.strain.number, unit)),
        "bias": lambda: draw_panels(maps.list_bias_panels(result, component, unit)),
        "simulation": lambda: draw_panels(maps.list_simulation_panels(result, component)),
        "residual": lambda: maps.draw_residual(result, unit=unit, scale=scale, slices=drawing.slices),
        "signed-residual": lambda: maps.draw_residual(result, signed=True, unit=unit, scale=scale,
                                                      slices=drawing.slices),
        "histogram": lambda: curves.draw_residual_histogram(result),
        "difference": lambda: maps.draw_difference(drawing.compared, component, unit, scale, drawing.slices),
        "krylov": lambda: _draw_krylov(result, drawing.other),
        "opening": lambda: _draw_opening(result, unit),
        "near-far": lambda: maps.draw_near_far(result, component, unit, scale),
        "line": lambda: curves.draw_line(result, drawing.line, unit),
        "corrections": lambda: curves.draw_corrections(result.corrections),
    }
    if result.separated is not None:
        by_kind["modes"] = partial(curves.draw_modes, result.separated)
    return by_kind[kind]()


def find_limits(result: Result, kind: str, look: Look, slices: Slices | None) -> Sequence[canvas.Limits]:
    """Find where the colours of a result by itself begin and end, a panel each, for a kind that can be animated."""
    if kind == "strain":
        return [look.scale.find_limits(panel.values) for panel in maps.list_strain_panels(result, look.strain)]
    if kind in ("residual", "signed-residual"):
        return [maps.find_residual_limits(result, signed=kind == "signed-residual", slices=slices)]
    displacement = result.displacement
    if kind == "deformed" and look.amplification is None:
        displacement = maps.remove_rigid_motion(result)
    return [look.scale.find_limits(look.unit.size * canvas.pick_component(displacement, look.component))]


def _draw_krylov(result: Result, other: Result | None) -> Figure:
    """Convergence of one result or two, which files' names tell apart, with their folders where these are the same."""
    results = [one for one in (result, other) if one is not None and _has_curves(one)]
    if len(results) == 1:
        return curves.draw_krylov({"": results[0].krylov})
    names = [one.path.name for one in results]
    return curves.draw_krylov({str(one.path) if names.count(name) > 1 else name: one.krylov
                               for name, one in zip(names, results, strict=True)})


def _draw_opening(result: Result, unit: canvas.LengthUnit) -> Figure:
    """Opening of all lines."""
    openings = enumerate(measure_openings(result), start=1)
    return curves.draw_opening({f"line {number}": of_line for number, of_line in openings}, unit)


THUMBNAIL_DPI = 60
"""Dots an inch of the map that a notebook shows."""


def draw_thumbnail(result: Result) -> str:
    """Draw a small map of the displacement, as HTML, below what the result says of itself and its verdict."""
    said = [repr(result)] if result.verdict is None else [repr(result), result.verdict.describe()]
    text = "<br>".join(escape(line) for line in said)
    stream = BytesIO()
    draw_result(result, "displacement").savefig(stream, format="png", dpi=THUMBNAIL_DPI)
    data = b64encode(stream.getvalue()).decode("ascii")
    return f'<p>{text}</p><img alt="displacement" src="data:image/png;base64,{data}">'


def draw_result(result: Result, kind: str, *, component: canvas.Component = "magnitude", number: str | None = None,
                 limits: canvas.Limits | None = None, palette: str | None = None, title: str | None = None,
                 **unknown: Any) -> Figure:
    """Draw a picture of a result over its reference image, as ``Result.plot`` does."""
    refuse_unknown_arguments(unknown, ("component", "number", "limits", "palette", "title"))
    if kind not in KINDS or kind in ("difference", "line"):
        drawable = [name for name in KINDS if name not in ("difference", "line")]
        raise InputError(f"kind = {kind!r}: one of {', '.join(drawable)}")
    if number is not None and number not in NUMBERS:
        raise InputError(f"number = {number!r}: one of {', '.join(NUMBERS)}")
    lacking = find_lacking(result, None)
    if kind in lacking:
        raise InputError(f"{result.path}: {lacking[kind]}")
    look = Look(component, maps.StrainChoice(number=number), unit=canvas.find_length_unit(result),
                scale=replace(canvas.OF_VALUES, limits=limits, palette=palette), title=title)
    require_known(result, look)
    reference = find_image(result) if kind in OVER_IMAGE else None
    source = None if reference is None else hold_source(reference, result.mesh.dim)
    return draw(kind, Drawing(result, None, look, maps.read_below(result.mesh, source)))

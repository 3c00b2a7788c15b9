"""``ddic plot``: figures of a result file; what can be asked for together, and of which file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from ddic.cli.app import frame_option
from ddic.cli.failures import failures_as_lines, warnings_as_lines
from ddic.errors import InputError
from ddic.plots.kinds import (
    ANIMATED,
    COMPONENTS,
    CURVES,
    KINDS,
    MEASURES,
    NUMBERS,
    ON_SLICES,
    ONLY_ASKED_FOR,
    OVER_IMAGE,
    WITH_LIMITS,
)

if TYPE_CHECKING:
    from ddic.io.result_reader import Result
    from ddic.plots.figures import Look
    from ddic.plots.slices import Below


FORMATS = ("png", "pdf", "svg")
MOVING = ("gif", "mp4")
"""Formats of animations."""


@click.command()
@click.argument("file", metavar="FILE", type=click.Path(path_type=Path))
@click.option("--kind", type=click.Choice([*KINDS, CURVES, "all"]), default="all",
              help="Figure to draw; all draws what the file allows, but not displacement, signed-residual and "
                   "histogram; of a series without --frame and --animate it draws curves over time.")
@frame_option
@click.option("--animate", is_flag=True, help="All frames of a series, one after the other, with the same colours.")
@click.option("--fps", type=click.FloatRange(0.1, 100.0), default=5.0, help="Frames a second of an animation.")
@click.option("--component", type=click.Choice(COMPONENTS), default="magnitude",
              help="Displacement component in colour; z of volumes.")
@click.option("--strain", "number", type=click.Choice(NUMBERS),
              help="Strain in colour, or with --kind sigma the strain whose standard deviation is; by default a panel "
                   "for each component.")
@click.option("--measure", type=click.Choice(MEASURES), default="infinitesimal", help="Strain tensor that is drawn.")
@click.option("--by-cell", is_flag=True, help="Draw the strain in the middle of cells, not that recovered at nodes.")
@click.option("--limits", type=(float, float), metavar="LOW HIGH",
              help="Where colours begin and end, in the unit of the colour bar; by default at --percentiles.")
@click.option("--percentiles", type=(click.FloatRange(0, 100), click.FloatRange(0, 100)), metavar="LOW HIGH",
              default=(2.0, 98.0), help="Of the values, between which colours lie; 0 100 for all values.")
@click.option("--cmap", "palette", metavar="NAME", help="One of matplotlib's colour maps; by default that of the kind.")
@click.option("--title", metavar="TEXT", help="In the place of the picture's own title; \"\" for none.")
@click.option("--scale-bar", type=click.FloatRange(min=0), is_flag=False, flag_value=0.0, metavar="[LENGTH]",
              help="Draw a scale bar, of a round length where none is given, in the unit of lengths.")
@click.option("--amplification", type=float,
              help="Factor on the whole displacement of the deformed mesh; by default rigid motion is taken out, and "
                   "what is left is amplified as far as no cell folds.")
@click.option("--line", type=(float, float, float, float), metavar="X1 Y1 X2 Y2",
              help="Ends of the line of --kind line, pixels of the reference image.")
@click.option("--line-z", "depths", type=(float, float), metavar="Z1 Z2", help="In volumes z of both ends.")
@click.option("--slice", "slices", multiple=True, metavar="AXIS=PLACE",
              help="Plane of a volume to draw, such as z=120, voxels; as often as wanted. By default three through the "
                   "middle of the mesh.")
@click.option("--units", type=click.Choice(["px", "physical"]),
              help="Of lengths; by default physical where the case gives images.pixel_size, or volumes.voxel_size.")
@click.option("--other", type=click.Path(path_type=Path),
              help="Second result: its difference is drawn, and its Krylov curves beside the first one's.")
@click.option("--image", type=click.Path(path_type=Path),
              help="Reference image; by default the one named in the result, if it is still there.")
@click.option("--format", "ending", type=click.Choice([*FORMATS, *MOVING]),
              help="Of the pictures, png by default, or of an animation, gif by default; mp4 needs ffmpeg.")
@click.option("--dpi", type=click.IntRange(20, 2400), default=150,
              help="Dots an inch; in PDF and SVG of images and colours alone.")
@click.option("--output", type=click.Path(path_type=Path, file_okay=False),
              help="Folder of the pictures; by default that of FILE.")
def plot(file: Path, kind: str, frame: int | None, animate: bool, fps: float,
         component: Literal["x", "y", "z", "magnitude"], number: str | None,
         measure: Literal["infinitesimal", "green-lagrange", "hencky"], by_cell: bool,
         limits: tuple[float, float] | None, percentiles: tuple[float, float], palette: str | None,
         title: str | None, scale_bar: float | None, amplification: float | None,
         line: tuple[float, float, float, float] | None, depths: tuple[float, float] | None, slices: tuple[str, ...],
         units: str | None, other: Path | None, image: Path | None, ending: str | None, dpi: int,
         output: Path | None) -> None:
    """Draw a result file as pictures named FILE.KIND.png, FILE.strain_yy.png say, for papers as PDF or SVG.

    Of a series: curves over time, a frame by its number (FILE.frame_N.KIND.png), or an animation (FILE.KIND.gif).
    """
    # Imported here because matplotlib is not needed by --help.
    from ddic.cli.plot_figures import PageFiles, plot_animation, plot_curves, plot_pictures
    from ddic.io.result_schema import TIME
    from ddic.io.series_reader import is_series_file, read_frame, read_series
    from ddic.plots.canvas import ColourScale, find_length_unit, format_caption
    from ddic.plots.figures import Drawing, Look, require_known
    from ddic.plots.maps import StrainChoice

    folder = file.parent if output is None else output
    with failures_as_lines(folder):
        _check_limits(kind, limits)
        _check_colours(percentiles, palette)
        if (kind == "line") != (line is not None) or (depths is not None and line is None):
            raise InputError("--line X1 Y1 X2 Y2 goes with --kind line: give both, or neither")
        planes = tuple(map(_parse_slice, slices))
        stem = file.stem if frame is None else f"{file.stem}.frame_{frame}"
        pages = PageFiles(folder, stem, _choose_ending(ending, animate=animate), dpi, (file, other, image))
        is_series = is_series_file(file)
        _check_frames(file, kind, frame, animate=animate, is_series=is_series)
        if is_series and frame is None and not animate:
            plot_curves(read_series(file), units, pages)
            return
        series = read_series(file) if animate else None
        with warnings_as_lines():
            result = read_frame(file, frame) if series is None else series[0]
            # Of a series the same frame.
            second = None if other is None else read_frame(other, frame if is_series_file(other) else None)
        kinds = _choose_kinds(kind, result, second)
        scale = ColourScale(limits, percentiles, palette)
        look = Look(component, StrainChoice(measure, number, by_cell), amplification, find_length_unit(result, units),
                    scale, title, scale_bar, planes)
        require_known(result, look)
        drawn_over = ON_SLICES if result.mesh.dim == 3 else OVER_IMAGE
        preview = _read_reference(result, look, image) if set(kinds) & set(drawn_over) else None
        drawing = Drawing(result, second, look, preview, _join_ends(line, depths, result.mesh.dim))
        if series is not None:
            plot_animation(series, kind, drawing, pages, fps)
        else:
            caption = None if frame is None else format_caption(frame, float(result.attributes[TIME]["deformed"]))
            plot_pictures(kinds, drawing, pages, caption)


def _parse_slice(text: str) -> tuple[str, float]:
    """Axis and place of a slice; raises InputError where it is none."""
    axis, _, place = text.partition("=")
    try:
        if axis in ("x", "y", "z") and math.isfinite(float(place)):
            return axis, float(place)
    except ValueError:
        pass
    raise InputError(f"--slice {text}: give x, y or z and its place in voxels, such as z=120")


def _join_ends(line: tuple[float, float, float, float] | None, depths: tuple[float, float] | None,
               dim: int) -> tuple[float, ...]:
    """Both ends of a line; raises InputError where they lie in another space than a result."""
    if line is None:
        return ()
    if (dim == 3) != (depths is not None):
        raise InputError("--line of a result of volumes needs --line-z Z1 Z2 too" if dim == 3 else
                         "--line-z: of a result of volumes; leave it out")
    return line if depths is None else (*line[:2], depths[0], *line[2:], depths[1])


def _check_limits(kind: str, limits: tuple[float, float] | None) -> None:
    """Raise InputError where limits are no interval, or would be those of several colour bars or of none."""
    if limits is None:
        return
    low, high = limits
    if not low < high:
        raise InputError(f"--limits {low:g} {high:g}: the first must be the smaller one")
    if kind not in WITH_LIMITS:
        raise InputError(f"--limits: for one kind with colours alone ({', '.join(WITH_LIMITS)}), not --kind {kind}")


def _check_colours(percentiles: tuple[float, float], palette: str | None) -> None:
    """Raise InputError where percentiles are no interval, or matplotlib has no colour map of a name."""
    from matplotlib import colormaps

    low, high = percentiles
    if not low < high:
        raise InputError(f"--percentiles {low:g} {high:g}: the first must be the smaller one")
    if palette is not None and palette not in colormaps:
        raise InputError(f"--cmap {palette}: matplotlib has no such colour map; viridis, cividis, magma and RdBu_r are "
                         "some that it has")


def _choose_ending(asked: str | None, *, animate: bool) -> str:
    """Format of the pictures; raises InputError where it does not fit, or there is no program for it."""
    from ddic.plots.series import require_writer

    fitting = MOVING if animate else FORMATS
    if asked is not None and asked not in fitting:
        what = "an animation is" if animate else "without --animate a picture is"
        raise InputError(f"--format {asked}: {what} one of {', '.join(fitting)}")
    ending = asked or fitting[0]
    require_writer(ending)
    return ending


def _check_frames(path: Path, kind: str, number: int | None, *, animate: bool, is_series: bool) -> None:
    """Raise InputError where what is asked for cannot be drawn of a file, which may hold a series."""
    if animate and number is not None:
        raise InputError("--animate and --frame: give one of them")
    if not is_series:
        asked = "--animate" if animate else f"--kind {CURVES}"
        if (animate or kind == CURVES) and path.is_file():
            raise InputError(f"{asked}: of a series, and {path} is the result of a pair; leave it out")
    elif animate and kind not in ANIMATED:
        raise InputError(f"--animate: of one --kind of {', '.join(ANIMATED)}, not {kind}")
    elif number is not None and kind == CURVES:
        raise InputError(f"--kind {CURVES}: of all frames; leave --frame out")
    elif not animate and number is None and kind not in (CURVES, "all"):
        raise InputError(f"{path}: holds the frames of a series; for --kind {kind} choose one by --frame, or give "
                         "--animate")


def _choose_kinds(asked: str, result: Result, other: Result | None) -> list[str]:
    """Figures to draw; raises InputError if the one asked for needs what is not there."""
    from ddic.io.result_schema import NODAL_INFINITESIMAL
    from ddic.plots.figures import find_lacking

    lacking = find_lacking(result, other)
    if asked in lacking:
        raise InputError(f"{result.path}: {lacking[asked]}")
    if asked != "all":
        return [asked]
    left_out = {*lacking, *ONLY_ASKED_FOR}
    if NODAL_INFINITESIMAL not in result.point_data:
        left_out.add("strain")
    return [kind for kind in KINDS if kind not in left_out]


def _read_reference(result: Result, look: Look, image: Path | None) -> Below:
    """What is drawn below: the image, unless it is no longer there, or slices of a volume."""
    from ddic.io.volume_file import hold_source
    from ddic.plots.figures import find_image
    from ddic.plots.maps import read_below

    image = find_image(result) if image is None else image
    with warnings_as_lines():
        if image is not None:
            return read_below(result.mesh, hold_source(image, result.mesh.dim), look.slices)
        named = str(result.attributes.get("provenance", {}).get("reference_path", ""))
        if named:
            click.echo(f"warning: {named} is no longer there and not drawn; give the image by --image", err=True)
        return read_below(result.mesh, None, look.slices)

"""What ``ddic plot`` draws of a series: curves over time, and animations."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from ddic.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

    from ddic.cli.plot import PageFiles
    from ddic.io.result_reader import Result
    from ddic.io.series_reader import SeriesResult
    from ddic.plots.canvas import Component, LengthUnit, Limits
    from ddic.plots.maps import SharedView, StrainChoice

CURVES = "curves"
ANIMATED = ("deformed", "displacement", "strain", "residual", "signed-residual")


@dataclass(frozen=True)
class FrameChoice:
    """What of a series is drawn.

    Attributes
    ----------
    number : int or None
        One frame.
    animate : bool
        All of them, one after the other.
    kind : str
        As --kind gives it.
    """

    number: int | None
    animate: bool
    kind: str

    def require_drawable(self, path: Path, *, is_series: bool) -> None:
        """Refuse what cannot be drawn of a file, which may hold a series; the InputError says what to give instead."""
        if self.animate and self.number is not None:
            raise InputError("--animate and --frame: give one of them")
        if not is_series:
            self._check_pair(path)
        elif self.animate and self.kind not in ANIMATED:
            raise InputError(f"--animate: of one --kind of {', '.join(ANIMATED)}, not {self.kind}")
        elif self.number is not None and self.kind == CURVES:
            raise InputError(f"--kind {CURVES}: of all frames; leave --frame out")
        elif not self.animate and self.number is None and self.kind not in (CURVES, "all"):
            raise InputError(f"{path}: holds the frames of a series; for --kind {self.kind} choose one by --frame, or "
                             "give --animate")

    def _check_pair(self, path: Path) -> None:
        if not path.is_file():
            return
        asked = "--animate" if self.animate else f"--kind {CURVES}" if self.kind == CURVES else None
        if asked is not None:
            raise InputError(f"{asked}: of a series, and {path} is the result of a pair; leave it out")


@dataclass(frozen=True)
class Look:
    """How frames are drawn, as the options give it.

    Attributes
    ----------
    component : {"x", "y", "magnitude"}
        Of the displacement.
    strain : StrainChoice
        Of the strain.
    amplification : float or None
        Of the deformed mesh.
    unit : LengthUnit
        Of lengths.
    limits : (float, float) or None
        Of colours; those of all frames where it is None.
    """

    component: Component
    strain: StrainChoice
    amplification: float | None
    unit: LengthUnit
    limits: Limits | None


@dataclass(frozen=True)
class SharedScale:
    """What the frames of an animation have in common.

    Attributes
    ----------
    limits : sequence of (float, float)
        Of the colours of each panel.
    view : SharedView or None
        Of deformed meshes.
    """

    limits: Sequence[Limits]
    view: SharedView | None


def find_shared_scale(series: SeriesResult, kind: str, look: Look) -> SharedScale:
    """Find colours and axes that suit all frames of a series, which is read frame by frame.

    ``kind`` is one of ANIMATED.
    """
    import numpy as np

    from ddic.plots.maps import find_shared_view

    # (n_frames, n_panels, 2)
    found = np.array([_find_limits(result, kind, look) for result in series])
    low, high = found[..., 0].min(axis=0).tolist(), found[..., 1].max(axis=0).tolist()
    limits = list(zip(low, high, strict=True))
    return SharedScale(limits if look.limits is None else [look.limits] * len(limits),
                       find_shared_view(series, look.amplification, look.unit) if kind == "deformed" else None)


def _find_limits(result: Result, kind: str, look: Look) -> Sequence[Limits]:
    """Where the colours of a frame by itself begin and end, a panel each."""
    from ddic.plots.canvas import choose_limits, pick_component
    from ddic.plots.maps import list_strain_panels
    from ddic.plots.residual import find_residual_limits

    if kind == "strain":
        return [choose_limits(panel.values) for panel in list_strain_panels(result, look.strain)]
    if kind in ("residual", "signed-residual"):
        return [find_residual_limits(result, signed=kind == "signed-residual")]
    return [choose_limits(look.unit.size * pick_component(result.displacement, look.component))]


def draw_pages(series: SeriesResult, draw: Callable[[Result], Figure]) -> Iterator[Figure]:
    """Draw the frames of a series, which is read frame by frame, one by one, a page each with its number and time."""
    from ddic.plots.canvas import draw_caption, format_caption

    for number, time, result in zip(series.numbers, series.times, series, strict=True):
        page = draw(result)
        draw_caption(page, format_caption(int(number), float(time)))
        yield page


def plot_curves(series: SeriesResult, units: str | None, pages: PageFiles) -> None:
    """Write a page with curves of a series, of at least one frame, over time.

    ``units`` is ``px`` or ``physical``, as --units gives it. Raises InputError where the unit is not known.
    """
    from ddic.case.own_outputs import PICTURE, require_own_output
    from ddic.io.replace_on_exit import made_folder
    from ddic.io.series_reader import gather_history
    from ddic.plots.canvas import find_length_unit, save_figure
    from ddic.plots.series import draw_time_curves

    target = pages.to_path(CURVES)
    require_own_output(target, PICTURE, (series.path,))
    unit = find_length_unit(series[0], units)
    figure = draw_time_curves(gather_history(series), series.path.name, unit)
    with made_folder(pages.folder):
        save_figure(figure, target, pages.dpi)
    click.echo(target)

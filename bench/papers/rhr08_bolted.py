"""Two bolted plates that slide by 7.5 px: convergence grid by grid, with enriched elements and with continuous ones.

The mesh, its elements and the slip are those of accept/slips.py. The start is that of [RHR08, section 3.2]: a rigid
translation, then grids of coarser images one after the other; ddic's matching of features, which would leave out all
grids but the finest for continuous elements, is switched off.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from matplotlib.figure import Figure
from numpy.typing import NDArray

import ddic
from bench.papers.compared import UNREAD, Compared
from bench.support.line_panels import (
    compare_opening,
    describe_noise,
    draw_openings,
    draw_residuals,
    find_dynamic_range,
    measure_residual,
)
from bench.support.opened_pair import Opened, find_field_error, mesh_inside, render, straight_line
from ddic.case.schema import StartSection
from ddic.images.binned import ArraySource
from ddic.images.sub_image import MaskedSource
from ddic.kinematics.enriched import Discontinuities
from ddic.methods.run import run_case
from ddic.parallel.phases import Phase
from ddic.parallel.team import Team
from ddic.plots.canvas import save_figure
from ddic.results.listener import Silence
from ddic.solvers.gauss_newton import IterationRecord
from ddic.start.binned_pair import BinnedPair
from ddic.start.multilevel import Pyramid, find_multilevel_start

NAME = "rhr08_bolted"

SLIP, SIZE, SMOKE_SIZE, ELEMENT, NOISE = 7.5, 2048, 256, 32, 2.0
"""Pixels; grey levels of 256."""

REPEATS = 3
"""Measurements with each kind of elements, alternated; the least CPU time of each counts."""

PAPER_RATIO = 2.36
"""CPU time of continuous elements over that of enriched ones in [RHR08, Table 1]."""

OWN_PIXELS = 1
"""Block size of the images as they are: the last grid."""

SHOWN = 0.05
"""CPU seconds from which on a phase is named."""

ENRICHED, CONTINUOUS = "enriched", "continuous"
KINDS = (CONTINUOUS, ENRICHED)

Pair = tuple[NDArray[Any], NDArray[Any]]


@dataclass
class Grid:
    """Gauss-Newton on one grid: RMS corrections, pixels of the image, and residuals, per cent of the dynamic range."""

    corrections: list[float] = field(default_factory=list)
    residuals: list[float] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Run:
    """What a kind of elements came to: result, iterations by block size, and CPU seconds by phase."""

    result: ddic.Result
    grids: dict[int, Grid]
    phases: dict[str, float]

    @property
    def seconds(self) -> float:
        """CPU seconds of all phases."""
        return sum(self.phases.values())

    @property
    def iterating(self) -> float:
        """CPU seconds of Gauss-Newton on the images as they are."""
        return self.phases[Phase.RESIDUAL] + self.phases[Phase.LINEAR_STEP]

    def describe_phases(self) -> str:
        """Say what takes the time."""
        return ", ".join(f"{name} {seconds:.2f}" for name, seconds in self.phases.items() if seconds >= SHOWN)

    @property
    def visited(self) -> float:
        """Pixels that these iterations visited, millions."""
        return float(self.result.gauss_newton["n_pixels"].sum()) / 1e6


def measure(folder: Path, *, smoke: bool) -> list[Compared]:
    """Measure the plates with both kinds of elements, and the jump with its standard deviation."""
    size = SMOKE_SIZE if smoke else SIZE
    opened = straight_line(size, SLIP)
    # The plate to the right of the line rests.
    opened = dataclasses.replace(opened, offset=opened.jumps[0] / 2)
    pair, mesh = render(opened, size, noise=NOISE, speckle=1.0), mesh_inside(size, ELEMENT)
    for name, image in zip(("reference", "deformed"), pair, strict=True):
        tifffile.imwrite(folder / f"{name}.tif", image)
    runs: dict[str, Run] = {}
    for _ in range(1 if smoke else REPEATS):
        for kind in KINDS:
            run = _measure_once(pair, mesh, opened, kind, folder)
            if kind not in runs or run.seconds < runs[kind].seconds:
                runs[kind] = run
    jump = ddic.measure_opening(ddic.measure(pair, mesh, **_list_options(opened, ENRICHED, opening="both"),
                                             output={"uncertainty": True}))
    curves = compare_opening(jump, np.tile([SLIP, 0.0], (len(jump.distance), 1)), jump.distance - jump.distance[0])
    save_figure(_draw_grids(runs), folder / f"{NAME}_fig13_14.png")
    save_figure(draw_residuals({f"{kind} elements": runs[kind].result for kind in KINDS}, pair[0]),
                folder / f"{NAME}_residual.png")
    save_figure(draw_openings(curves, "jump"), folder / f"{NAME}_jump.png")
    setting = (f"two plates of {size} x {size} px slide by {SLIP:g} px, 16 bit, noise of {NOISE:g} grey levels of 256, "
               f'{ELEMENT}-px elements, line given (discontinuity.opening = "tangential", for the jump "both"; '
               'discontinuity.uncertainty = 0), solver.method = "monolithic", correlation.spoilt_pixels = "keep", '
               "start.features = false, for continuous elements gauss_newton.max_iterations = 500")
    return [*_compare_grids(setting, runs), *_compare_times(setting, runs),
            *_compare_fields(setting, runs, opened, pair),
            Compared("[RHR08, section 6.1]", "jump along the line", setting, "a uniform slip is known here alone",
                     curves["along"].describe(), "the paper tells no standard deviation of the jump"),
            Compared("[RHR08, section 6.1]", "jump across the line, both openings free", setting, "as above",
                     curves["across"].describe(), "")]


def _list_options(opened: Opened, kind: str, opening: str = "tangential") -> dict[str, Any]:
    """What a kind of elements is measured with: all pixels count, as in the paper, and the line lies as it is given."""
    options: dict[str, Any] = {"solver": {"method": "monolithic"}, "correlation": {"spoilt_pixels": "keep"},
                               "start": {"features": False}}
    if kind == CONTINUOUS:
        return {**options, "gauss_newton": {"max_iterations": 500}}
    return {**options, "discontinuity": [{**section, "uncertainty": 0} for section in opened.sections(opening)]}


def _measure_once(pair: Pair, mesh: ddic.Mesh, opened: Opened, kind: str, folder: Path) -> Run:
    summary = run_case(Team.alone(), _write_case(folder, mesh, kind, _list_options(opened, kind)), Silence())
    result = ddic.open(folder / f"{kind}.vtkhdf")
    of_range = 100.0 / find_dynamic_range(pair[0])
    grids = _follow_pyramid(pair, mesh, opened, kind)
    table = result.gauss_newton
    grids[OWN_PIXELS] = Grid(table["rms_correction_px"].tolist(), (of_range * table["residual_std_grey"]).tolist())
    return Run(result, grids, {str(phase): seconds for phase, seconds in summary.cpu_seconds.items()})


def _write_case(folder: Path, mesh: ddic.Mesh, kind: str, options: dict[str, Any]) -> Path:
    """Write the case of a kind of elements: as a run is timed, from files to a file."""
    (x0, y0), (x1, y1) = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    lines = ['[images]\nreference = "reference.tif"\ndeformed = "deformed.tif"',
             f"[mesh.structured]\nregion = [{x0}, {y0}, {x1}, {y1}]\nelement_size = {ELEMENT}",
             f'[output]\nfile = "{kind}.vtkhdf"']
    for name, section in options.items():
        header, keys = (f"[[{name}]]", section[0]) if isinstance(section, list) else (f"[{name}]", section)
        lines += [header, *(f"{key} = {json.dumps(value)}" for key, value in keys.items())]
    path = folder / f"{kind}.toml"
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return path


def _follow_pyramid(pair: Pair, mesh: ddic.Mesh, opened: Opened, kind: str) -> dict[int, Grid]:
    """Gauss-Newton on the grids of coarser images, by the side of their blocks, pixels; coarsest first.

    A run finds the same, but correlates more than ``LARGEST_WHOLE`` blocks without a line in tiles, whose iterations
    it does not tell.
    """
    reference, deformed = (MaskedSource(ArraySource(Path("memory"), image.astype(np.float32))) for image in pair)
    lines = Discontinuities(opened.lines, ("tangential",)) if kind == ENRICHED else Discontinuities()
    grids: dict[int, Grid] = {}

    def keep(size: int, record: IterationRecord) -> None:
        coarse = pyramid.read_whole(size).reference.image
        grid = grids.setdefault(size, Grid())
        grid.corrections.append(size * record.size.rms)
        grid.residuals.append(100.0 * record.grey.residual_std / find_dynamic_range(coarse.read(coarse.extent)))

    pyramid = Pyramid(BinnedPair(reference, deformed, 1), mesh, "global", lines, report=keep)
    find_multilevel_start(pyramid, StartSection(features=False))
    return grids


def _draw_grids(runs: Mapping[str, Run]) -> Figure:
    """Corrections above, residuals below, against the number of the iteration, grid after grid; a column a kind."""
    figure = Figure(figsize=(9.0, 6.2), layout="constrained")
    above, below = figure.subplots(2, 2, sharex=True, sharey="row")
    for k, (kind, run) in enumerate(runs.items()):
        begin = 1
        for number, (size, grid) in enumerate(run.grids.items()):
            at = begin + np.arange(len(grid.corrections))
            label = "pixels" if size == OWN_PIXELS else f"blocks of {size} px"
            for axes, values in ((above[k], grid.corrections), (below[k], grid.residuals)):
                axes.plot(at, values, "o-", color=f"C{number}", markersize=3, linewidth=1.2, label=label)
            begin += len(grid.corrections)
        above[k].set_title(f"{kind} elements")
        below[k].set_xlabel("iteration, grid after grid [-]")
    above[0].set_yscale("log")
    below[0].set_ylim(bottom=0.0)
    above[0].set_ylabel("RMS correction [px]")
    below[0].set_ylabel("residual [% of the dynamic range]")
    above[1].legend(fontsize="x-small")
    for axes in figure.axes:
        axes.grid(which="both", alpha=0.25)
    return figure


def _compare_grids(setting: str, runs: Mapping[str, Run]) -> list[Compared]:
    rows = []
    for figure, kind in (("Fig. 13", CONTINUOUS), ("Fig. 14", ENRICHED)):
        grids = runs[kind].grids
        found = ", ".join(f"{size} px: {len(grid.corrections)}" for size, grid in grids.items())
        last = grids[OWN_PIXELS]
        rows.append(Compared(
            f"[RHR08, {figure}]", f"iterations by grid, {kind} elements (side of the blocks)", setting, UNREAD,
            f"{found}; on the last grid the residual goes from {last.residuals[0]:.2f} to {last.residuals[-1]:.2f} % "
            "of the dynamic range", "synthetic images in place of a real assembly's"))
    return rows


def _compare_times(setting: str, runs: Mapping[str, Run]) -> list[Compared]:
    smooth, cut = runs[CONTINUOUS], runs[ENRICHED]
    n_smooth, n_cut = (len(run.grids[OWN_PIXELS].corrections) for run in (smooth, cut))
    place = "[RHR08, Table 1]"
    return [
        Compared(place, "iterations on the last grid, continuous over enriched", setting, "more with continuous ones",
                 f"{n_smooth} over {n_cut}", "", "fewer with enriched elements", n_cut < n_smooth, judged_small=True),
        Compared(place, "CPU time, continuous over enriched", setting, f"{PAPER_RATIO:g}",
                 f"{smooth.seconds / cut.seconds:.2f} ({smooth.seconds:.2f} s over {cut.seconds:.2f} s)",
                 f"seconds by phase, continuous: {smooth.describe_phases()}; enriched: {cut.describe_phases()}: "
                 "iterations (residual, linear step) are the smaller part of either"),
        Compared(place, "CPU time of Gauss-Newton on the last grid, continuous over enriched", setting,
                 f"{PAPER_RATIO:g}, of all", f"{smooth.iterating / cut.iterating:.2f}",
                 "passes over the pixels about slow nodes alone make most iterations of continuous elements cheap"),
        Compared(place, "pixels visited by the iterations on the last grid, continuous over enriched", setting,
                 f"{PAPER_RATIO:g}, of all CPU time", f"{smooth.visited / cut.visited:.2f} ({smooth.visited:.1f} and "
                 f"{cut.visited:.1f} million)", "what the ratio of times would be if pixels were all that takes time"),
    ]


def _compare_fields(setting: str, runs: Mapping[str, Run], opened: Opened, pair: Pair) -> list[Compared]:
    residuals = {kind: measure_residual(run.result, pair[0]) for kind, run in runs.items()}
    errors = {kind: find_field_error(run.result, opened) for kind, run in runs.items()}
    told = ", ".join(f"{kind} {residual:.2f} %" for kind, residual in residuals.items())
    return [Compared("[RHR08, section 6.1]", "residual in per cent of the dynamic range", setting,
                     "less with enriched elements", told, describe_noise(NOISE, pair[0]), "less with enriched elements",
                     residuals[ENRICHED] < residuals[CONTINUOUS], judged_small=True),
            Compared("[RHR08, section 6.1]", "RMS error of the displacement", setting, "not known of real images",
                     ", ".join(f"{kind} {error:.4f} px" for kind, error in errors.items()))]

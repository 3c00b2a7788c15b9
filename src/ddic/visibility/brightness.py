"""Whether a pair needs its grey levels corrected, and the change of brightness given to the reference image.

Where the light changes from cell to cell, a gain and an offset of each cell leave the slope of the light inside it,
which Gauss-Newton takes for a displacement. The light is continuous: offsets of cells, averaged at nodes and
interpolated between them, tell its slope.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ddic.arrays import Array
from ddic.functionals.grey_statistics import GreyCorrection, find_weighted_median
from ddic.functionals.view import FrameView
from ddic.mesh.interpolation import interpolate_located, place_in_cells
from ddic.mesh.mesh import sum_about_nodes
from ddic.mesh.raster import list_pixels
from ddic.parallel.distribution import sum_shared_nodes
from ddic.parallel.field import ByView, add_views
from ddic.problem.residual_model import ResidualModel
from ddic.visibility.seen_cells import SeenCells, TypicalCell

SEEN = 0.9
"""Correlation coefficient of f and g in a cell, relative to what contrast and noise let expect, from which on its
offset is that of the light: what lies in front of the specimen is dark or bright, too. A larger value leaves out cells
in which the light changes much."""

LEAST_SLOPE = 0.25
"""Difference of brightness between nodes of a cell, relative to the standard deviation of the residual, from which on
the cell is given a slope. A smaller value spends time on what is less than noise."""

GLOBAL_SHARE = 0.02
"""Mean square of a brightness change of the whole image, relative to the residual's variance, from which on it is
corrected. A larger share leaves as much of it in the residual, where it counts like noise."""

CELL_SHARE = 0.1
"""The same of what differs from cell to cell: a correction of each cell costs some of its information."""

GROSS = 4.0
"""Brightness change of a cell, squared and relative to the residual's variance, from which on it is gross."""

GROSS_SHARE = 0.005
"""Share of the pixels in cells of gross changes, a reflection say, from which on cells are corrected one by one."""

FEWEST_PIXELS = 64
"""Pixels of a cell, in the median, from which on it can tell its own gain and offset from a displacement."""

LEAST_CHANGE, LEAST_GROSS = 0.005, 0.02
"""Brightness change relative to the contrast of the speckle below which it is none, and not gross: images without noise
are no reason to correct what interpolation leaves."""

ORDER: tuple[GreyCorrection, ...] = ("none", "global", "element")
"""From the simplest on."""


def match_brightness(whole: ResidualModel, seen: ByView[SeenCells],
                     typical: Mapping[int, TypicalCell]) -> ResidualModel:
    """Give the reference images the slopes of the light in a frame, of which ``whole`` has all pixels; collective."""
    sums = whole.views.map(lambda view, cells: _sum_offsets(view, cells, typical[view.camera], whole.n_cameras), seen)
    totals = sum_shared_nodes(whole.team, whole.subdomains, add_views(sums))
    views = whole.team.together(lambda: whole.views.map(
        lambda view, total: _even_out(view, total, typical[view.camera]), whole.views.fill(totals)))
    return replace(whole, views=views)


def _sum_offsets(view: FrameView, cells: SeenCells, typical: TypicalCell, n_cameras: int) -> Array:
    """Pixels of the cells about each node, and the sum of their offsets, (n_nodes, 2 n_cameras), by camera."""
    mesh = view.correlation.mesh
    sums = np.zeros((mesh.n_nodes, 2 * n_cameras))
    expected = typical.contrast / max(typical.contrast + typical.noise, 1e-300)
    n_pixels = np.where(cells.coefficient >= SEEN * expected, cells.n_pixels, 0.0)
    offsets = cells.mean_f - typical.gain * cells.mean_g - typical.offset
    sums[:, 2 * view.camera] = sum_about_nodes(mesh, n_pixels)
    sums[:, 2 * view.camera + 1] = sum_about_nodes(mesh, n_pixels * offsets)
    return sums


def _even_out(view: FrameView, sums: Array, typical: TypicalCell) -> FrameView:
    """A view whose f has the light of g."""
    correlation, place = view.correlation, 2 * view.camera
    n_pixels, total = sums[:, place], sums[:, place + 1]
    light = total / np.maximum(n_pixels, 1.0)
    mesh = correlation.mesh
    of_corners = light[mesh.connectivity]
    first = mesh.offsets[:-1]
    differences = np.maximum.reduceat(of_corners, first) - np.minimum.reduceat(of_corners, first)
    # Where a node is known by no cell, all of its cells are hidden.
    is_known = np.logical_and.reduceat(n_pixels[mesh.connectivity] > 0, first)
    sloping = np.flatnonzero(is_known & (differences > LEAST_SLOPE * np.sqrt(typical.noise)))
    if not len(sloping):
        return view
    image = correlation.reference
    removed = np.zeros(image.values.shape, dtype=np.float32)
    pixels, cells = list_pixels(correlation.raster, sloping)
    located = place_in_cells(mesh, cells, pixels.astype(np.float64))
    at_pixels = interpolate_located(mesh, light[:, None], located)[:, 0]
    removed[pixels[:, 1] - image.window.y0, pixels[:, 0] - image.window.x0] = at_pixels
    return replace(view, correlation=replace(correlation, reference=image.correct_light(removed)))


def choose_correction(cells: Mapping[int, SeenCells], typical: Mapping[int, TypicalCell],
                      least: GreyCorrection = "none", most: GreyCorrection = "element") -> GreyCorrection:
    """Choose the simplest correction of grey levels, one for all cameras, that leaves no more than noise.

    Means and standard deviations are compared, which a displacement that is still wrong hardly changes, and medians
    over cells, which a hidden part does not change. ``least`` was chosen before, never less than which is chosen;
    ``most`` is the most that can be.
    """
    wanted = [_choose(of_camera, typical[camera]) for camera, of_camera in cells.items() if len(of_camera.n_pixels)]
    chosen = max([least, *wanted], key=ORDER.index)
    return min(chosen, most, key=ORDER.index)


def _choose(cells: SeenCells, typical: TypicalCell) -> GreyCorrection:
    n = cells.n_pixels
    change_of_mean = find_weighted_median(cells.mean_f - cells.mean_g, n)
    change_of_spread = find_weighted_median(cells.spread_f - cells.spread_g, n)
    least = max(GLOBAL_SHARE * typical.noise, LEAST_CHANGE**2 * typical.contrast)
    is_whole = change_of_mean**2 + change_of_spread**2 > least
    correction = (typical.gain, typical.offset) if is_whole else (1.0, 0.0)
    if np.median(n) >= FEWEST_PIXELS and _differ(cells, correction, typical):
        return "element"
    return "global" if is_whole else "none"


def _differ(cells: SeenCells, correction: tuple[float, float], typical: TypicalCell) -> bool:
    """Whether the brightness changes otherwise in some cells than in most."""
    noise, (gain, offset) = typical.noise, correction
    squared = ((cells.mean_f - gain * cells.mean_g - offset)**2
               + (cells.spread_f - gain * cells.spread_g)**2)
    # What is hidden, or not found yet, is not explained by brightness.
    is_explained = cells.variance <= GROSS * noise
    n = cells.n_pixels
    is_gross = is_explained & (squared > max(GROSS * noise, LEAST_GROSS**2 * typical.contrast))
    if n[is_gross].sum() > GROSS_SHARE * n.sum():
        return True
    mean_square = float((n * squared)[is_explained].sum() / max(n[is_explained].sum(), 1.0))
    return mean_square > max(CELL_SHARE * noise, LEAST_CHANGE**2 * typical.contrast)

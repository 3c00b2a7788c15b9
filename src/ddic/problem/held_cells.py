"""Cells that mechanics hold pixels off what the images show: where these show them, and how that pulls.

Where a cut-off wavelength is long beside what the specimen does, equilibrium holds the field off; Gauss-Newton may
also still be on its way. What is found within a few pixels of where the field puts it is the specimen's, and none of
its pixels is foreign; what hides the specimen is found nowhere.

Grey levels of other speckle say nothing of the way back, and drive the field to and fro; where the cell is seen does:
it pulls with M_e (u_seen - u), the force of a displacement as large in the linear theory of [LPHR11]. That grows up to
the distance that grey levels capture, and no further, as theirs does: a crack, which mechanics smear, would pull all
about it along.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.functionals.correlation import Residual
from ddic.functionals.grey_statistics import GreySums
from ddic.functionals.view import FrameView, View
from ddic.images.spline import PADDING, SplineImage
from ddic.images.window import Window
from ddic.mesh.mesh import Mesh, pad_cells
from ddic.parallel.field import ByView

Image = NDArray[np.float32]

CAPTURED = 1.5
"""Distance up to which grey levels say the way to where a cell is seen, pixels: some third of a speckle."""

RELEASED = 0.75
"""Distance to where a cell was seen up to which it is let go, pixels: half of what grey levels capture. They know the
place to a hundredth, where the search knows it to some tenths; at a distance once captured, pulls would come and go."""

REACH = 8
"""Distance in which a cell is sought, pixels: mechanics hold waves of some 8 px off by as much. A larger one takes
longer, and finds by chance what is elsewhere."""

SMALLEST = 31
"""Least side of the square of pixels that is sought, pixels: six speckles, which two places hardly have in common."""

GUESSED, FOUND = 0.4, 0.8
"""Correlation coefficients, relative to what the noise lets expect, from which on the best whole-pixel translation is
refined to an affine motion, and from which on that is believed. Unlike squares of 40 speckles have one of 0.15 at one
place, 0.45 at the best of all in reach, and 0.6 after an affine motion."""

BESIDE = 0.15
"""Distance by which a cell is seen beside where it is put, pixels: of what is seen where it is put, the
residual tells what hides it."""

PIXEL = 0.5
"""Error of the displacement up to which a pixel's grey levels agree, pixels."""

LEAST_AGREEMENT = 0.97
"""Share of the pixels that must agree where a cell is found: of clean pairs 0.98 or more do, of squares with a wire
that stands still or with dirt on the lens, which correlate with themselves, less than 0.95."""

SHOWN = 0.3
"""Displacement error, pixels, whose residual beyond noise a cell may have where it is seen: nearly all of clean pairs
have less; most cells that hold little of the specimen, which is found beside them, have more."""

ENOUGH = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-6)
"""Iterations of the affine motion, and gain of its correlation coefficient below which they end."""

SMOOTHED = 1
"""Side of the window over which the affine motion's images are averaged, pixels. Averages of f would end at its border,
where those of g do not: one over 3 px puts corners 0.1 to 0.3 px off, more than noise of 16 grey levels does."""


@dataclass(frozen=True, eq=False)
class HeldCells:
    """Cells of a view that are held off, and where the frame shows them.

    Attributes
    ----------
    cells : (n,) int64 array
        Their numbers.
    shown_at : (n, n_monomials, dim) array
        Displacement of their corners (``pad_cells``) there, pixels of the view's image.
    """

    cells: IntArray
    shown_at: Array

    @classmethod
    def none(cls, mesh: Mesh) -> Self:
        """No cell of a mesh is."""
        return cls(np.zeros(0, dtype=np.int64), np.zeros((0, mesh.n_monomials, mesh.dim)))

    def measure_away(self, view: View, q: Array) -> Array:
        """Measure how far the corners are seen from where unknowns put them, pixels, as ``shown_at``."""
        mesh = view.correlation.mesh
        put = view.kinematics.displacement(q).reshape(mesh.nodes.shape)[pad_cells(mesh)[self.cells]]
        return np.asarray(self.shown_at - put)

    def keep(self, before: Self, view: View, q: Array) -> Self:
        """Keep also those of an earlier look that are still far away, seen there, and not among these."""
        kept = (measure_mean_distance(before.measure_away(view, q)) > RELEASED) & ~np.isin(before.cells, self.cells)
        return type(self)(np.concatenate([self.cells, before.cells[kept]]),
                          np.concatenate([self.shown_at, before.shown_at[kept]]))


@dataclass(frozen=True, eq=False)
class PulledView:
    """A view with cells that are pulled to where they are seen.

    Attributes
    ----------
    view, held : View, HeldCells
        The view, and these cells of it.
    hessians : (n, n_monomials dim, n_monomials dim) array
        M_e of each, grey levels squared per pixel squared.
    """

    view: View
    held: HeldCells
    hessians: Array

    def pull(self, q: Array) -> Array:
        """Forces on the subdomain's unknowns, (n_unknowns,)."""
        interpolation, held = self.view.correlation.interpolation, self.held
        away = held.measure_away(self.view, q)
        distance = measure_mean_distance(away)
        captured = away * (CAPTURED / np.maximum(distance, CAPTURED))[:, None, None]
        forces = np.zeros(interpolation.n_dofs)
        np.add.at(forces, interpolation.cell_dofs[held.cells],
                  np.einsum("cij,cj->ci", self.hessians, captured.reshape(len(held.cells), -1)))
        return self.view.weight * self.view.kinematics.project_vector(forces)

    def keep_others(self, residual: Residual) -> Residual:
        """Keep the residual of the other cells, as if these had no pixels."""
        moments, cell_sums = residual.moments.copy(), residual.cell_sums.values.copy()
        moments[self.held.cells] = 0.0
        cell_sums[self.held.cells] = 0.0
        return replace(residual, moments=moments, cell_sums=GreySums(cell_sums))


def pull_view(view: FrameView, q: Array, held: HeldCells, *, follows: bool) -> PulledView | None:
    """Prepare the pull of a view's cells; None where none is held off."""
    if not len(held.cells):
        return None
    followed = view.with_moved_gradient(q) if follows else view
    is_held = np.zeros(followed.correlation.mesh.n_cells, dtype=bool)
    is_held[held.cells] = True
    hessians = followed.correlation.confine(is_held).compute_cell_hessians()
    return PulledView(view, held, hessians[held.cells])


def sum_pulls(pulled: ByView[PulledView | None], q: Sequence[Array]) -> list[Array]:
    """Compute what b is given, (n_unknowns,) of each subdomain, grey levels squared per pixel."""
    return [np.sum([np.zeros(len(q_s)), *(view.pull(q_s) for view in of_views if view is not None)], axis=0)
            for of_views, q_s in zip(pulled, q, strict=True)]


def find_cells_beside(view: FrameView, q: Array, cells: IntArray, noise: float) -> dict[int, Array]:
    """Find the cells that the frame shows beside where unknowns put them, not far off.

    ``view`` has all pixels that the frame shows, ``cells`` are those that are sought, ``noise`` is the variance of the
    residual where nothing is foreign, grey levels squared. This gives, by the number of each cell that is found, how
    far its corners (``pad_cells``) are seen from where they are put, (4, 2), pixels: in the mean BESIDE or more.
    """
    correlation = view.correlation
    mesh = correlation.mesh
    if mesh.dim == 3:
        # OpenCV, which looks for them, knows images only.
        return {}
    moved = mesh.nodes + view.kinematics.displacement(q).reshape(mesh.nodes.shape)
    found = {}
    for cell, corners in zip(cells.tolist(), pad_cells(mesh)[cells], strict=True):
        square = _place_square(mesh.nodes[corners], correlation.extent)
        # From the whole image, without anything masked: neither the cut into subdomains nor what is hidden has a say.
        usable = correlation.source.find_usable(square)
        if not (usable is None or usable.all()):
            continue
        motion = _fit_motion(mesh.nodes[corners], moved[corners])
        f = np.ascontiguousarray(correlation.source.image.read(square), dtype=np.float32)
        is_own = correlation.raster.draw_cells(np.array([cell]), square) > 0
        about = square.grow(REACH)
        g = view.deformed.read_aside(_displace_box(motion, about))
        affine = _seek(f, _displace(g, motion, about), is_own, noise)
        if affine is None:
            continue
        put = mesh.nodes[corners] - [square.x0, square.y0]
        away = put @ affine[:, :2].T + affine[:, 2] - put
        if measure_mean_distance(away) >= BESIDE:
            found[cell] = away
    return found


def measure_mean_distance(away: Array) -> Array:
    """Mean distance of the corners of cells, (..., 4, 2), pixels; (...)."""
    return np.asarray(np.linalg.norm(away, axis=-1).mean(axis=-1))


def _seek(f: Image, g: Image, is_own: BoolArray, noise: float) -> Array | None:
    """Affine motion, (2, 3), that takes f to where it is seen in g; None where it is nowhere.

    A whole-pixel translation is sought, and refined; g is REACH larger on all sides. What is found has to be the cell,
    of which some pixels of f are, not what lies beside it.
    """
    seen = np.isfinite(g)
    # What is out of the image or masked correlates with nothing.
    filled = np.where(seen, g, np.float32(g[seen].mean() if seen.any() else 0.0))
    contrast = float(f.var())
    if not (contrast > 0 and filled.std() > 0):
        return None
    expected = contrast / (contrast + noise)
    coefficients = cv2.matchTemplate(filled, f, cv2.TM_CCOEFF_NORMED)
    row, column = np.unravel_index(int(np.nanargmax(coefficients)), coefficients.shape)
    if coefficients[row, column] < GUESSED * expected:
        return None
    affine = np.array([[1.0, 0.0, column], [0.0, 1.0, row]], dtype=np.float32)
    try:
        coefficient, affine = cv2.findTransformECC(f, filled, affine, cv2.MOTION_AFFINE, ENOUGH,
                                                   seen.astype(np.uint8), SMOOTHED)
    except cv2.error:
        # It does not converge where nothing is alike.
        return None
    if coefficient < FOUND * expected:
        return None
    at_found = cv2.warpAffine(g, affine, f.shape[::-1], flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
                              borderValue=float("nan"))
    if not _is_cell(f, at_found, is_own, noise):
        return None
    return np.asarray(affine - [[0.0, 0.0, REACH], [0.0, 0.0, REACH]], dtype=np.float64)


def _is_cell(f: Image, g: Image, is_own: BoolArray, noise: float) -> bool:
    """Whether f agrees with g where it is found, over the square and over the cell's own pixels."""
    seen = np.isfinite(g)
    if not (is_own & seen).any():
        return False
    # As bright and as strong in contrast as makes most of both alike.
    (middle_f, spread_f), (middle_g, spread_g) = ((np.median(image), np.subtract(*np.percentile(image, [75, 25])))
                                                  for image in (f[seen], g[seen]))
    r = f - middle_f - (g - middle_g) * (spread_f / max(spread_g, 1e-6))
    slope = np.hypot(*np.gradient(f))
    agrees = np.abs(r) <= 3.0 * np.sqrt(noise) + PIXEL * slope
    if np.mean(agrees[seen]) < LEAST_AGREEMENT:
        return False
    own = is_own & seen
    of_error = 0.5 * SHOWN**2 * np.mean(slope[own] ** 2)
    return bool(np.mean(r[own] ** 2) - noise <= of_error)


def _place_square(nodes: Array, extent: Window) -> Window:
    """The box about some nodes, at least SMALLEST wide, within an extent."""
    centre, half = nodes.mean(axis=0), np.maximum(np.ptp(nodes, axis=0), SMALLEST) / 2
    return Window.between(np.floor(centre - half), np.ceil(centre + half)).intersection(extent)


def _fit_motion(nodes: Array, moved: Array) -> Array:
    """Affine motion, (3, 2) on [1, x, y], that is nearest to how some nodes have moved."""
    return np.asarray(np.linalg.lstsq(np.column_stack([np.ones(len(nodes)), nodes]), moved, rcond=None)[0])


def _displace_box(motion: Array, box: Window) -> Window:
    """The box of where a motion takes a box of pixels."""
    corners = np.array([[1.0, x, y] for x in (box.x0, box.x1) for y in (box.y0, box.y1)])
    moved = corners @ motion
    return Window.between(np.floor(moved.min(axis=0)), np.ceil(moved.max(axis=0)) + 1)


def _displace(g: SplineImage, motion: Array, box: Window) -> Image:
    """Take g to the pixels of a box; nan beyond its window and on what is excluded."""
    # Clean pairs never come here, and need not wait for it.
    from scipy.ndimage import map_coordinates

    x, y = np.meshgrid(np.arange(box.x0, box.x1), np.arange(box.y0, box.y1))
    left, top = (motion[0, k] + motion[1, k] * x + motion[2, k] * y - corner
                 for k, corner in enumerate((g.window.x0, g.window.y0)))
    pad = PADDING[g.degree]
    values = map_coordinates(g.coefficients, [top + pad, left + pad], np.float32, order=g.degree,
                             mode="nearest", prefilter=False)
    is_inside = (left >= 0) & (top >= 0) & (left <= g.window.width - 1) & (top <= g.window.height - 1)
    if g.usable is not None:
        rows = np.clip(np.floor(top).astype(int), 0, g.window.height - 1)
        columns = np.clip(np.floor(left).astype(int), 0, g.window.width - 1)
        is_inside &= g.usable[rows, columns] > 0
    return np.where(is_inside, values, np.float32(np.nan))

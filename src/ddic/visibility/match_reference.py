"""The reference image as bright and as blurred as a frame is, so that what is left of the residual is displacement.

Where the light changes from cell to cell, a gain and an offset of each cell leave the slope of the light inside it,
which Gauss-Newton takes for a displacement. The light is continuous: offsets of cells, averaged at nodes and
interpolated between them, tell its slope.

Where a frame is less sharp than the reference image, by motion or focus, the reference is blurred as much. Else grad f
is not the gradient of g, and Gauss-Newton strays; the residual would be the difference in sharpness.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ddic.arrays import Array, BoolArray
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.functionals.view import FrameView
from ddic.images.binned import BLUR_NOTE, Blur, BlurredSource
from ddic.images.sub_image import MaskedSource, read_reference
from ddic.inputs.cameras import Camera
from ddic.mesh.interpolation import interpolate_located, place_in_cells
from ddic.mesh.mesh import sum_about_nodes
from ddic.mesh.raster import list_pixels_in_turn
from ddic.mesh.rotation import build_rotation
from ddic.parallel.distribution import find_quantile_of_all, sum_shared_nodes
from ddic.parallel.field import ByView, add_views
from ddic.parallel.team import Team
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

UNLIKE = 0.03
"""Residual variance of most cells, relative to the contrast of the reference, from which on the sharpness of both
images is compared: that costs a pass over the pixels."""

LESS_SHARP = 0.7
"""Mean square of the grey level's slope in g relative to f, in the direction where it is least, below which f is
blurred. Noise and interpolation leave 0.95 of it."""

LARGEST_BLUR = 12.0
"""Standard deviation, pixels, of the strongest blur that is looked for: speckles of 5 px have no contrast left."""

TILE, BLOCK = 64, 8
"""Sides of tiles in which the contrast of blocks is compared, and of the blocks, pixels: light varies little in a tile,
and a blur leaves most of what is larger than a block."""

SAMPLE = 512
"""Rows and columns of a subdomain that are looked at."""


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
    removed = np.zeros(image.window.shape, dtype=np.float32)
    for pixels, cells in list_pixels_in_turn(correlation.raster, sloping):
        located = place_in_cells(mesh, cells, pixels.astype(np.float64))
        removed[image.window.index(pixels)] = interpolate_located(mesh, light[:, None], located)[:, 0]
    return replace(view, correlation=replace(correlation, reference=image.correct_light(removed)))


def choose_correction(team: Team, cells: Mapping[int, SeenCells], typical: Mapping[int, TypicalCell],
                      least: GreyCorrection = "none", most: GreyCorrection = "element") -> GreyCorrection:
    """Choose the simplest correction of grey levels, one for all cameras, that leaves no more than noise; collective.

    Means and standard deviations are compared, which a displacement that is still wrong hardly changes, and medians
    over all ranks' cells, which a hidden part does not change. ``cells`` are this rank's; ``least`` was chosen before,
    never less than which is chosen; ``most`` is the most that can be.
    """
    wanted = [_choose(team, of_camera, typical[camera]) for camera, of_camera in cells.items()]
    chosen = max([least, *wanted], key=ORDER.index)
    return min(chosen, most, key=ORDER.index)


def _choose(team: Team, cells: SeenCells, typical: TypicalCell) -> GreyCorrection:
    n = cells.n_pixels
    most_have = find_quantile_of_all(team, n, np.ones(len(n)))
    if most_have is None:
        return "none"
    change_of_mean, change_of_spread = (
        find_quantile_of_all(team, of_f - of_g, n) or 0.0
        for of_f, of_g in [(cells.mean_f, cells.mean_g), (cells.spread_f, cells.spread_g)])
    least = max(GLOBAL_SHARE * typical.noise, LEAST_CHANGE**2 * typical.contrast)
    is_whole = change_of_mean**2 + change_of_spread**2 > least
    correction = (typical.gain, typical.offset) if is_whole else (1.0, 0.0)
    if most_have >= FEWEST_PIXELS and _differ(team, cells, correction, typical):
        return "element"
    return "global" if is_whole else "none"


def _differ(team: Team, cells: SeenCells, correction: tuple[float, float], typical: TypicalCell) -> bool:
    """Whether the brightness changes otherwise in some cells than in most; collective."""
    noise, (gain, offset) = typical.noise, correction
    squared = (cells.mean_f - gain * cells.mean_g - offset)**2 + (cells.spread_f - gain * cells.spread_g)**2
    # What is hidden, or not found yet, is not explained by brightness.
    is_explained = cells.variance <= GROSS * noise
    n = cells.n_pixels
    is_gross = is_explained & (squared > max(GROSS * noise, LEAST_GROSS**2 * typical.contrast))
    of_gross, of_all, explained, change = team.sum(np.array(
        [n[is_gross].sum(), n.sum(), n[is_explained].sum(), (n * squared)[is_explained].sum()]))
    if of_gross > GROSS_SHARE * of_all:
        return True
    return bool(change / max(explained, 1.0) > max(CELL_SHARE * noise, LEAST_CHANGE**2 * typical.contrast))


def match_sharpness(whole: ResidualModel, cameras: Sequence[Camera], q: Sequence[Array],
                    typical: Mapping[int, TypicalCell]) -> tuple[ResidualModel, tuple[str, ...]]:
    """Blur the reference images as much as the frame is, with notes for the log; collective.

    ``whole`` is of all pixels that the frame shows, ``q`` where it is thought to show them, ``typical`` at q. A sharp
    frame leaves the model as it is, and so does one of volumes, which nothing smears along one direction.
    """
    if whole.subdomains[0].mesh.dim == 3:
        return whole, ()
    blurs: dict[int, Blur] = {}
    for camera in cameras:
        of_most = typical[camera.number]
        if of_most.noise > UNLIKE * of_most.contrast:
            found = _find_blur(whole.team, list(_take_samples(whole, q, camera.number)))
            if found is not None:
                blurs[camera.number] = found
    if not blurs:
        return whole, ()
    views = whole.team.together(lambda: whole.views.map(
        lambda view: _blur_reference(view, cameras[view.camera].reference, blurs.get(view.camera))))
    notes = []
    for number, blur in blurs.items():
        of_camera = "" if len(cameras) == 1 else f" ({cameras[number].label})"
        notes.append(f"{BLUR_NOTE}{of_camera}, which is blurred as much: standard deviation {blur.along:.1f} px at "
                     f"{np.rad2deg(blur.direction):.0f} degrees, {blur.across:.1f} px across")
    return replace(whole, views=views, blurs=tuple(sorted(blurs.items()))), tuple(notes)


def _take_samples(whole: ResidualModel, q: Sequence[Array], camera: int) -> Iterator[tuple[Array, Array]]:
    """F and g(x + u) on a part of each owned subdomain; nan where g is not seen."""
    for view, q_s in zip(whole.views.flat, whole.views.fill(q).flat, strict=True):
        if view.camera == camera:
            f = view.correlation.reference.values[:SAMPLE, :SAMPLE].astype(np.float32)
            g = f - view.compute_residual_image(q_s)[:SAMPLE, :SAMPLE]
            yield f.astype(np.float64), g.astype(np.float64)


def _find_blur(team: Team, samples: Sequence[tuple[Array, Array]]) -> Blur | None:
    """The blur of f that gives it the slopes of g; None where f is no sharper; collective."""
    shown = [np.isfinite(g) for _, g in samples]
    of_g = _sum_slopes(team, [g for _, g in samples], shown)
    if not np.linalg.det(of_g) > 0:
        # A frame that shows nothing is not blurred.
        return None

    def compare(images: Sequence[Array]) -> tuple[Array, Array]:
        """Slopes of images in place of f, and those of g if it were as bright."""
        gain = _compare_contrasts(team, images, [g for _, g in samples])
        return _sum_slopes(team, images, shown), gain**2 * of_g

    of_f, as_bright = compare([f for f, _ in samples])
    if not np.linalg.det(of_f) > 0:
        return None
    root = np.linalg.inv(_take_root(of_f))
    ratios, directions = np.linalg.eigh(root @ as_bright @ root)
    if ratios[0] >= LESS_SHARP:
        return None
    return _fit_blur(float(np.arctan2(directions[1, 0], directions[0, 0])), [f for f, _ in samples], compare)


def _take_root(matrix: Array) -> Array:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.sqrt(values)) @ vectors.T)


def _compare_contrasts(team: Team, one: Sequence[Array], other: Sequence[Array]) -> float:
    """Contrast of means over blocks in images over that in others, which light changes more than a blur; collective."""
    ratios = []
    for f, g in zip(one, other, strict=True):
        for top in range(0, f.shape[0] - TILE + 1, TILE):
            for left in range(0, f.shape[1] - TILE + 1, TILE):
                tile = np.s_[top:top + TILE, left:left + TILE]
                of_f, of_g = (image[tile].reshape(TILE // BLOCK, BLOCK, -1, BLOCK).mean(axis=(1, 3)).std()
                              for image in (f, g))
                # A tile where the other shows nothing says nothing.
                ratios += [of_f / of_g] if of_g > 0 else []
    everywhere = np.array(team.gather_lists(ratios))
    everywhere = everywhere[np.isfinite(everywhere)]
    return float(np.median(everywhere)) if len(everywhere) else 1.0


def _sum_slopes(team: Team, images: Sequence[Array], shown: Sequence[BoolArray]) -> Array:
    """Sum of grad grad^T by central differences over the pixels with four neighbours, (2, 2); collective."""
    total = np.zeros((2, 2))
    for image, seen in zip(images, shown, strict=True):
        inner = seen[1:-1, 1:-1] & seen[1:-1, 2:] & seen[1:-1, :-2] & seen[2:, 1:-1] & seen[:-2, 1:-1]
        by_x = 0.5 * (image[1:-1, 2:] - image[1:-1, :-2])[inner]
        by_y = 0.5 * (image[2:, 1:-1] - image[:-2, 1:-1])[inner]
        total += [[by_x @ by_x, by_x @ by_y], [by_x @ by_y, by_y @ by_y]]
    return np.asarray(team.sum(total))


def _fit_blur(direction: float, images: Sequence[Array],
              compare: Callable[[Sequence[Array]], tuple[Array, Array]]) -> Blur:
    """Standard deviations of the blur that gives images the slopes of g; collective."""
    # Sharp frames never come here, and need not wait for it.
    from scipy.optimize import least_squares

    turn = build_rotation(direction)

    def miss(deviations: Array) -> Array:
        blur = Blur(float(deviations[0]), float(deviations[1]), direction)
        slopes, wanted = compare([blur.apply(f.astype(np.float32)).astype(np.float64) for f in images])
        return np.asarray(np.log(np.diag(turn.T @ slopes @ turn)) - np.log(np.diag(turn.T @ wanted @ turn)))

    found = least_squares(miss, [1.0, 0.3], bounds=(0.0, LARGEST_BLUR), xtol=1e-3, ftol=1e-4, diff_step=1e-2)
    return Blur(float(found.x[0]), float(found.x[1]), direction)


def _blur_reference(view: FrameView, reference: MaskedSource, blur: Blur | None) -> FrameView:
    if blur is None:
        return view
    correlation = view.correlation
    source = MaskedSource(BlurredSource(reference, blur))
    sharp = correlation.reference
    # Too small windows were made larger.
    blurred = read_reference(source, sharp.window, view.deformed.degree, correlation.threads).restrict(sharp.window)
    return replace(view, correlation=replace(correlation, source=source,
                                             reference=replace(blurred, usable=sharp.usable)))

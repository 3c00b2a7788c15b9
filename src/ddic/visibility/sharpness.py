"""Where a frame is less sharp than the reference image, by motion or focus, the reference is blurred as much.

Else grad f is not the gradient of g, and Gauss-Newton strays; the residual would be the difference in sharpness.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ddic.arrays import Array, BoolArray
from ddic.functionals.view import FrameView
from ddic.images.binned import BLUR_NOTE, Blur, BlurredSource
from ddic.images.sub_image import MaskedSource, read_reference
from ddic.inputs.cameras import Camera
from ddic.mesh.plane import build_rotation
from ddic.parallel.team import Team
from ddic.problem.residual_model import ResidualModel
from ddic.visibility.seen_cells import TypicalCell

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


def match_sharpness(whole: ResidualModel, cameras: Sequence[Camera], q: Sequence[Array],
                    typical: Mapping[int, TypicalCell]) -> tuple[ResidualModel, tuple[str, ...]]:
    """Blur the reference images as much as the frame is, with notes for the log; collective.

    ``whole`` is of all pixels that the frame shows, ``q`` where it is thought to show them, ``typical`` at q. A sharp
    frame leaves the model as it is.
    """
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
    notes = tuple(_describe(blurs[camera.number], "" if len(cameras) == 1 else f" ({camera.label})")
                  for camera in cameras if camera.number in blurs)
    return replace(whole, views=views, blurs=tuple(sorted(blurs.items()))), notes


def _describe(blur: Blur, of_camera: str) -> str:
    return (f"{BLUR_NOTE}{of_camera}, which is blurred as much: standard deviation {blur.along:.1f} px at "
            f"{np.rad2deg(blur.direction):.0f} degrees, {blur.across:.1f} px across")


def _take_samples(whole: ResidualModel, q: Sequence[Array], camera: int) -> Iterator[tuple[Array, Array]]:
    """F and g(x + u) on a part of each owned subdomain; nan where g is not seen."""
    for view, q_s in zip(whole.views.flat, whole.views.fill(q).flat, strict=True):
        if view.camera == camera:
            f = view.correlation.reference.values[:SAMPLE, :SAMPLE]
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

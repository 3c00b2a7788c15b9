"""Calibration of a near camera by one picture of each: a search by normalised cross-correlation, then registration."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice, product

import cv2
import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.calibration.registration import CameraModel, Kind, Registration, fit_similarity, read_near_image, register
from ddic.errors import ConvergenceError, InputError
from ddic.images.camera import CameraMapping, similarity
from ddic.images.source import ImageSource
from ddic.images.spline import read_gradient
from ddic.images.window import Window
from ddic.mesh.rotation import build_rotation

RATIO_RANGE = 0.15
"""Relative error of the given ratio that the search covers; a larger one takes longer, for steps are shares of it."""

ROTATION_RANGE = 5.0
"""Rotation that the search covers either way, degrees; a larger one takes longer, for steps are shares of it."""

TILE = 64
"""Side of the searched tile, far px: long enough to be told apart, short enough for coarse steps."""

_SMALL_TILE = 32
"""Side, far px, that a tile keeps where the near field is less than twice as long."""

LEAST_TILE = 16
"""Side below which a tile of speckle may match anywhere, far px."""

_CLEAR = 0.9
"""Correlation coefficient at which no further candidate is tried."""

BLANK = 1e-3
"""Standard deviation of a tile's grey levels below which it shows nothing."""

_STEPS = 6
"""Steps either way in which the ranges of ratio and of rotation are searched; fewer may step over the peak."""

_FINE_STEPS = (0.5, 0.25)
"""Shares of a step by which the best candidate is moved afterwards, one after the other."""

_TILES = 4
"""Tiles that are searched at most, until one leads to a registration."""

_APART = 0.75
"""Least distance of two tiles over their side."""

_BLUR = 1.0
"""Gaussian blur of both images, far px: widens the peak that the search must hit."""

Grey = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Match:
    """A tile of the near image found in the far image.

    Attributes
    ----------
    mapping : CameraMapping
        Similarity from far to near px.
    coefficient : float
        Correlation coefficient of the tile.
    centre, side : (float, float) and float
        Of the tile, near px.
    """

    mapping: CameraMapping
    coefficient: float
    centre: tuple[float, float]
    side: float


class TileSearch:
    """The far image and the near image reduced to its resolution, both slightly blurred.

    Parameters
    ----------
    far, near : (height, width) array
        The near image covers at least LEAST_TILE far px either way.
    ratio : float
        About the near px per far px.

    Attributes
    ----------
    far : (height, width) array
        The far image, its mean taken off.
    reduced : (rows, columns) array
        The near image at about one px per far px.
    scale : (float, float)
        Near px per reduced px along x and y.
    ratio : float
        The given near px per far px.
    side : int
        Of the tiles, far px.
    """

    def __init__(self, far: Grey, near: Grey, ratio: float) -> None:
        height, width = near.shape
        size = max(round(width / ratio), 1), max(round(height / ratio), 1)
        self.ratio = ratio
        self.scale = width / size[0], height / size[1]
        self.reduced = cv2.GaussianBlur(cv2.resize(near, size, interpolation=cv2.INTER_AREA), (0, 0), _BLUR)
        most = min(int(n / (1 + RATIO_RANGE)) for n in (*size, far.shape[1], far.shape[0]))
        # Half the image, so that a tile is left in view where part of the near field is not.
        self.side = max(min(TILE, most, max(_SMALL_TILE, min(size) // 2)), 1)
        self.far = cv2.GaussianBlur(far, (0, 0), _BLUR)
        self.far -= self.far.mean()

    def find_matches(self, *, fixed: bool = False) -> Iterator[Match]:
        """Find the best match of each tile, most texture first; where ``fixed``, upright and with the given ratio."""
        for centre in self._choose_tiles():
            yield self._find_best(centre, fixed)

    def _choose_tiles(self) -> list[tuple[float, float]]:
        """Centres of tiles, reduced px, those with the most gradient in its weaker direction first."""
        height, width = self.reduced.shape
        # The tile may be larger in the near image by the error of the ratio.
        margin = 0.5 * self.side * (1 + RATIO_RANGE)
        along_x, along_y = (_places_along(size, margin) for size in (width, height))
        weaker = self._weaker_gradient()
        centres = [(float(x), float(y)) for x, y in product(along_x, along_y)]
        by_texture = sorted(centres, key=lambda centre: -weaker[int(centre[1]), int(centre[0])])
        chosen: list[tuple[float, float]] = []
        for x, y in by_texture:
            distances = (max(abs(x - other_x), abs(y - other_y)) for other_x, other_y in chosen)
            if all(distance >= _APART * self.side for distance in distances):
                chosen.append((x, y))
        return chosen[:_TILES]

    def _weaker_gradient(self) -> Array:
        """Mean square of the gradient in its weaker direction over the tile about each place of the reduced image."""
        by_y, by_x = np.gradient(self.reduced)
        tile = (self.side, self.side)
        xx = cv2.blur(by_x * by_x, tile)
        xy = cv2.blur(by_x * by_y, tile)
        yy = cv2.blur(by_y * by_y, tile)
        # The smaller eigenvalue of [[xx, xy], [xy, yy]].
        return np.asarray(0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy**2))

    def _find_best(self, centre: tuple[float, float], fixed: bool) -> Match:
        """The best match of a tile over ratios and rotations: on a grid, then around its best point."""
        best, at = self._match(centre, 0.0, 0.0), (0.0, 0.0)
        if fixed:
            return best
        steps = [k / _STEPS for k in range(-_STEPS, _STEPS + 1)]
        # The most likely first: the given ratio, upright.
        grid = sorted(product(steps, steps), key=lambda step: step[0] ** 2 + step[1] ** 2)
        for step in grid[1:]:
            if best.coefficient >= _CLEAR:
                break
            tried = self._match(centre, *step)
            if tried.coefficient > best.coefficient:
                best, at = tried, step
        for fine in _FINE_STEPS:
            around = [(at[0] + k * fine / _STEPS, at[1] + j * fine / _STEPS) for k, j in product((-1, 0, 1), repeat=2)]
            matches = [(best, at), *((self._match(centre, *step), step) for step in around)]
            best, at = max(matches, key=lambda match_and_step: match_and_step[0].coefficient)
        return best

    def _match(self, centre: tuple[float, float], stretch: float, turn: float) -> Match:
        """Find a tile in the far image; stretch, turn: shares of the ranges of ratio and rotation."""
        ratio = self.ratio * (1 + RATIO_RANGE * stretch)
        degrees = ROTATION_RANGE * turn
        matrix = ratio * build_rotation(np.deg2rad(degrees))
        half = (self.side - 1) / 2
        template = self._turned_tile(centre, matrix)
        coefficients = cv2.matchTemplate(self.far, template, cv2.TM_CCOEFF_NORMED)
        if template.std() < BLANK:
            # OpenCV takes it for alike everything.
            coefficients = np.full_like(coefficients, -1.0)
        row, column = np.unravel_index(int(np.argmax(coefficients)), coefficients.shape)
        # The tile's centre, in near px and where it was found in the far image.
        x, y = ((place + 0.5) * scale - 0.5 for place, scale in zip(centre, self.scale, strict=True))
        offset = np.array([x, y]) - matrix @ np.array([column + half, row + half])
        mapping = similarity(ratio, degrees, (float(offset[0]), float(offset[1])))
        return Match(mapping, float(coefficients[row, column]), (x, y), self.side * ratio)

    def _turned_tile(self, centre: tuple[float, float], matrix: Array) -> Grey:
        """The tile about a place of the reduced image, as the far image shows it; matrix: far to near px."""
        turned = matrix / np.array(self.scale)[:, None]
        half = (self.side - 1) / 2
        start = np.array(centre) - turned @ np.array([half, half])
        tile = cv2.warpAffine(self.reduced, np.column_stack([turned, start]), (self.side, self.side),
                              flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REFLECT_101)
        return np.asarray(tile)


def _places_along(size: int, margin: float) -> Array:
    """Five places along a side of so many px, a margin from its ends; the middle where there is no room."""
    last = size - 1
    if last <= 2 * margin:
        return np.array([last / 2])
    return np.linspace(margin, last - margin, 5)


LEAST_COEFFICIENT = 0.5
"""Correlation coefficient below which two pictures are not taken to show the same surface."""

_OTHER_RATIOS = (0.5, 2.0, 0.7, 1.4)
"""Factors on the ratio that are tried where nothing was found, to say what is wrong with it."""

_OTHER_TILES = 1
"""Tiles that are tried at each of these ratios."""

_LEAST_START = 0.3
"""Correlation coefficient of a tile below which no registration is begun from it; more may miss blurred ones."""

_ROUGH = 0.01
"""Tolerance, near px, of registrations whose result only starts the next one."""

_ROUGH_SAMPLES = 3
"""Samples of a far pixel either way, at most, in these registrations."""

_GRID = 11
"""Places either way at which the mapping is compared with a similarity."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """The mapping from the far to the near image and how well it is known; std: standard deviation.

    Attributes
    ----------
    mapping : CameraMapping
        From far to near px.
    homography_std : (3, 3) array
        Of the homography's numbers.
    k1_std : float
        Of the radial distortion, 0 where it is not a parameter.
    ratio : float
        Near px per far px of the similarity closest to the mapping over the near image.
    rotation : float
        Of that similarity, degrees.
    offset : (float, float)
        Of that similarity: where far pixel (0, 0) would be, near px.
    similarity_std : (4,) array
        Of ratio, rotation and the two offsets.
    deviation : (float, float)
        RMS and largest distance of the mapping from that similarity over the near image, near px.
    places : (5, 2) array
        Corners and centre of the near image, near px.
    places_far : (5, 2) array
        The same in the far image, far px.
    places_std : (5, 2) array
        Of the near position of these specimen points, near px.
    registration : Registration
        Grey-level correction, correlation coefficient, residual.
    far_size, near_size : (int, int)
        Width and height, px.
    """

    mapping: CameraMapping
    homography_std: Array
    k1_std: float
    ratio: float
    rotation: float
    offset: tuple[float, float]
    similarity_std: Array
    deviation: tuple[float, float]
    places: Array
    places_far: Array
    places_std: Array
    registration: Registration
    far_size: tuple[int, int]
    near_size: tuple[int, int]


def calibrate_near_camera(far: ImageSource, near: ImageSource, ratio: float, kind: Kind = "homography",
                          distortion: bool = False) -> Calibration:
    """Find the mapping that takes positions in the far image to positions in the near image.

    The near image may be turned by 5 degrees; ``ratio`` is about its px per far px, right within 15 %. ``kind`` says
    what the mapping may be: a translation keeps the ratio as given. ``distortion`` asks for k1 too. Raises InputError
    where the ratio cannot be right, an image has no texture, the two show nothing in common, or the near image does not
    lie in the far one.
    """
    _check_sizes(far, near, ratio)
    pair = _Pair(far, near, ratio, kind, distortion)
    found, best = pair.locate(ratio, None)
    if found is None:
        raise InputError(_explain_failure(pair, far, near, ratio, best))
    _check_inside(found, far, near)
    return _describe(found, (far.width, far.height), (near.width, near.height))


class _Pair:
    """Both images, (height, width); the far one's gradient, the near one as a spline; and what is asked for."""

    def __init__(self, far: ImageSource, near: ImageSource, ratio: float, kind: Kind, distortion: bool) -> None:
        self.far, self.near = _read_grey(far), _read_grey(near)
        self.gradient = read_gradient(far, far.extent, 3)
        self.spline = read_near_image(near, ratio)
        self.kind, self.distortion = kind, distortion

    def locate(self, ratio: float, n_tiles: int | None) -> tuple[Registration | None, float]:
        """The registration from the first tile that leads to one, and the best coefficient met on the way."""
        best = 0.0
        matches = TileSearch(self.far, self.near, ratio).find_matches(fixed=self.kind == "translation")
        for match in islice(matches, n_tiles):
            if match.coefficient < _LEAST_START:
                continue
            try:
                found = self._grow(match, ratio)
            except ConvergenceError:
                continue
            best = max(best, found.local_coefficient)
            if found.local_coefficient >= LEAST_COEFFICIENT:
                return found, best
        return None, best

    def _grow(self, match: Match, ratio: float) -> Registration:
        """Register the tile that was found, then twice as large a part of the near image, and so on."""
        whole = self.spline.window
        half = match.side / 2
        part = _part(match.centre, half, whole)
        kind: Kind = "translation" if self.kind == "translation" else "similarity"
        model = self._make_model(kind, ratio, part, match.mapping, False)
        rough = replace(self.spline, samples=min(self.spline.samples, _ROUGH_SAMPLES))
        found = register(self.gradient, rough, model, model.fit(match.mapping), part, _ROUGH)
        # Texture that repeats by chance over a tile is not worth a larger one.
        while found.local_coefficient >= LEAST_COEFFICIENT:
            last = part == whole
            half *= 2
            part = _part(match.centre, half, whole)
            model = self._make_model(self.kind, ratio, part, found.mapping, self.distortion)
            start = model.fit(found.mapping)
            if last:
                samples = max(round(_local_ratio(found.mapping, part)), 1)
                fine = replace(self.spline, samples=samples)
                return register(self.gradient, fine, model, start, part)
            found = register(self.gradient, rough, model, start, part, _ROUGH)
        return found

    def _make_model(self, kind: Kind, ratio: float, part: Window, mapping: CameraMapping,
                    distorts: bool) -> CameraModel:
        """A model whose parameters are written about the middle of a part of the near image."""
        height, width = self.near.shape
        return CameraModel(
            kind=kind,
            ratio=ratio,
            middle=mapping.to_specimen(_middle(part))[0],
            length=max(part.width, part.height) / (2 * ratio),
            centre=np.array([(width - 1) / 2, (height - 1) / 2]),
            radius=float(np.hypot(width, height)) / 2,
            distorts=distorts,
        )


def _part(centre: tuple[float, float], half: float, whole: Window) -> Window:
    """The square about a place, half a side either way, as far as it lies in the image."""
    x, y = centre
    return Window((int(x - half), int(y - half)), (int(x + half) + 1, int(y + half) + 1)).intersection(whole)


def _middle(part: Window) -> Array:
    """The middle of a window, px, (1, 2)."""
    return np.array([[(part.x0 + part.x1 - 1) / 2, (part.y0 + part.y1 - 1) / 2]])


def _local_ratio(mapping: CameraMapping, part: Window) -> float:
    """Near px per far px in the middle of a part of the near image."""
    jacobian = mapping.jacobian(mapping.to_specimen(_middle(part)))[0]
    return float(np.sqrt(abs(np.linalg.det(jacobian))))


def _read_grey(source: ImageSource) -> NDArray[np.float32]:
    """All grey levels of an image, which must not be blank."""
    values = np.asarray(source.read(source.extent), dtype=np.float32)
    if values.min() == values.max():
        raise InputError(f"{source.path}: all pixels have the grey level {values.flat[0]:g}; there is no texture to "
                         "find one image in the other by")
    return values


def _check_sizes(far: ImageSource, near: ImageSource, ratio: float) -> None:
    """Refuse a ratio with which the near image cannot lie in the far one, or could not be found."""
    if not (np.isfinite(ratio) and ratio > 1):
        raise InputError(f"--ratio {ratio:g}: must be more than 1, near pixels per far pixel; "
                         "the image with more pixels per millimetre is NEAR")
    covered = near.width / ratio, near.height / ratio
    # The ratio may be larger than given by so much.
    across, down = (size / (1 + RATIO_RANGE) for size in covered)
    if across > far.width or down > far.height:
        raise InputError(f"{near.path}: {near.width} x {near.height} px at a ratio of {ratio:g} cover "
                         f"{covered[0]:.0f} x {covered[1]:.0f} far px, more than the {far.width} x {far.height} px of "
                         f"{far.path}; give a larger --ratio, or swap the images if the first is NEAR")
    if min(across, down) < LEAST_TILE:
        raise InputError(f"{near.path}: {near.width} x {near.height} px at a ratio of {ratio:g} cover only "
                         f"{covered[0]:.0f} x {covered[1]:.0f} far px, too few to be found; at least "
                         f"{math.ceil(LEAST_TILE * (1 + RATIO_RANGE))} are needed either way; check --ratio")


def _check_inside(found: Registration, far: ImageSource, near: ImageSource) -> None:
    """Refuse a near image that the far one does not show whole."""
    corners = near.extent.corners
    seen = found.mapping.to_specimen(corners)
    beyond = (far.width - 0.5, far.height - 0.5)
    outside = (seen < -0.5).any(axis=1) | (seen > beyond).any(axis=1)
    if outside.any():
        corner, place = corners[outside][0], seen[outside][0]
        raise InputError(f"{near.path}: lies outside {far.path} in part: its corner ({corner[0]:g}, {corner[1]:g}) "
                         f"is at ({place[0]:.1f}, {place[1]:.1f}) px of an image of {far.width} x {far.height} px; "
                         "crop the near images, or use a far image that shows all of it")


def _explain_failure(pair: _Pair, far: ImageSource, near: ImageSource, ratio: float, best: float) -> str:
    """Say what is wrong: the ratio, if another one does, or the images."""
    for factor in _OTHER_RATIOS:
        other = ratio * factor
        try:
            _check_sizes(far, near, other)
        except InputError:
            continue
        found, _ = pair.locate(other, _OTHER_TILES)
        if found is not None:
            right = _local_ratio(found.mapping, pair.spline.window)
            return (f"--ratio {ratio:g}: is off by more than {100 * RATIO_RANGE:.0f} %; {near.path} fits into "
                    f"{far.path} at a ratio of {right:.3f}: give --ratio {right:.3g}")
    return (f"{near.path}: was not found in {far.path}: the best correlation coefficient is {best:.2f} at ratios of "
            f"{ratio:g} within {100 * RATIO_RANGE:.0f} % and rotations within {ROTATION_RANGE:g} degrees, "
            f"{LEAST_COEFFICIENT:g} is needed; the images have no common texture, the near field lies outside the far "
            "image, or the two files are swapped: check them")


def _describe(found: Registration, far_size: tuple[int, int], near_size: tuple[int, int]) -> Calibration:
    """All that is told of a calibration."""
    model, mapping = found.model, found.mapping
    near_image = Window.of_size(*near_size)
    places = np.concatenate([near_image.corners, _middle(near_image)])
    places_far = mapping.to_specimen(places)
    by_parameters = model.differentiate(found.parameters, places_far)
    places_std = np.sqrt(np.einsum("nip,pq,niq->ni", by_parameters, found.covariance, by_parameters))
    # Places all over the near image, where the mapping is compared with a similarity.
    x, y = np.meshgrid(np.linspace(0, near_size[0] - 1, _GRID), np.linspace(0, near_size[1] - 1, _GRID))
    grid = mapping.to_specimen(np.column_stack([x.ravel(), y.ravel()]))
    similarity, rest = fit_similarity(mapping, grid)
    ratio, rotation, x0, y0 = _similarity_of(similarity)
    distances = np.hypot(*rest.T)
    return Calibration(
        mapping=mapping,
        homography_std=_deviations(lambda mapping: mapping.homography.ravel(), found).reshape(3, 3),
        k1_std=float(np.sqrt(found.covariance[-1, -1])) if model.distorts else 0.0,
        ratio=float(ratio),
        rotation=float(rotation),
        offset=(float(x0), float(y0)),
        similarity_std=_deviations(lambda mapping: _similarity_of(fit_similarity(mapping, grid)[0]), found),
        deviation=(float(np.sqrt((distances**2).mean())), float(distances.max())),
        places=places,
        places_far=places_far,
        places_std=places_std,
        registration=found,
        far_size=far_size,
        near_size=near_size,
    )


def _similarity_of(mapping: CameraMapping) -> Array:
    """Ratio, rotation in degrees, and offset of a mapping that is a similarity."""
    h = mapping.homography
    return np.array([np.hypot(h[0, 0], h[1, 0]), np.rad2deg(np.arctan2(h[1, 0], h[0, 0])), h[0, 2], h[1, 2]])


def _deviations(function: Callable[[CameraMapping], Array], found: Registration) -> Array:
    """Standard deviations of a function of the mapping, by central differences along its parameters."""
    def evaluate(parameters: Array) -> Array:
        return function(found.model.build_mapping(parameters))

    sizes = 1e-6 * np.maximum(1.0, np.abs(found.parameters))
    slopes = [(evaluate(found.parameters + step) - evaluate(found.parameters - step)) / (2 * size)
              for size, step in zip(sizes, np.diag(sizes), strict=True)]
    by_parameters = np.array(slopes).T
    variances = np.einsum("np,pq,nq->n", by_parameters, found.covariance, by_parameters)
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)))

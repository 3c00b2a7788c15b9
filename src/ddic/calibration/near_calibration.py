"""Calibration of a near camera from one picture of each camera: where the near image lies in the far one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ddic.calibration.camera_models import CameraModel, Kind, fit_similarity
from ddic.calibration.registration import TOLERANCE, NearImage, Registration, read_near_image, register
from ddic.calibration.template_search import LEAST_TILE, RATIO_RANGE, ROTATION_RANGE, Match, prepare_search
from ddic.errors import ConvergenceError, InputError
from ddic.images.camera import CameraMapping
from ddic.images.source import ImageSource
from ddic.images.spline import GradientImage, read_gradient
from ddic.images.window import Window

Array = NDArray[np.float64]

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


def calibrate(far: ImageSource, near: ImageSource, ratio: float, kind: Kind = "homography",
              distortion: bool = False) -> Calibration:
    """Find the mapping that takes positions in the far image to positions in the near image.

    Parameters
    ----------
    far, near : ImageSource
        One picture of each camera; the near one may be turned by 5 degrees.
    ratio : float
        Rough near px per far px, right within 15 %.
    kind : {"translation", "similarity", "homography"}, optional
        What the mapping may be; a translation keeps the ratio as given.
    distortion : bool, optional
        Also find k1.

    Returns
    -------
    Calibration
        The mapping and how well it is known.

    Raises
    ------
    InputError
        Where the ratio cannot be right, an image has no texture, the two show nothing in common, or the near image
        does not lie in the far one.
    """
    _check_sizes(far, near, ratio)
    whole = Window(0, 0, far.width, far.height)
    pair = _Pair(
        far=_read_grey(far),
        near=_read_grey(near),
        gradient=read_gradient(far, whole, 3),
        spline=read_near_image(near, ratio),
        kind=kind,
        distortion=distortion,
    )
    found, best = pair.locate(ratio, None)
    if found is None:
        raise InputError(_explain_failure(pair, far, near, ratio, best))
    _check_inside(found, far, near)
    return _describe(found, (far.width, far.height), (near.width, near.height))


@dataclass(frozen=True, eq=False)
class _Pair:
    """Both images, (height, width); the far one's gradient, the near one as a spline; and what is asked for."""

    far: NDArray[np.float32]
    near: NDArray[np.float32]
    gradient: GradientImage
    spline: NearImage
    kind: Kind
    distortion: bool

    def locate(self, ratio: float, n_tiles: int | None) -> tuple[Registration | None, float]:
        """The registration from the first tile that leads to one, and the best coefficient met on the way."""
        best = 0.0
        search = prepare_search(self.far, self.near, ratio)
        matches = search.find_matches(fixed=self.kind == "translation")
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
                return register(self.gradient, fine, model, start, part, TOLERANCE)
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
    return Window(int(x - half), int(y - half), int(x + half) + 1, int(y + half) + 1).intersection(whole)


def _middle(part: Window) -> Array:
    """The middle of a window, px, (1, 2)."""
    return np.array([[(part.x0 + part.x1 - 1) / 2, (part.y0 + part.y1 - 1) / 2]])


def _local_ratio(mapping: CameraMapping, part: Window) -> float:
    """Near px per far px in the middle of a part of the near image."""
    jacobian = mapping.jacobian(mapping.to_specimen(_middle(part)))[0]
    return float(np.sqrt(abs(np.linalg.det(jacobian))))


def _read_grey(source: ImageSource) -> NDArray[np.float32]:
    """All grey levels of an image, which must not be blank."""
    values = np.asarray(source.read(Window(0, 0, source.width, source.height)), dtype=np.float32)
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
    corners = _places(near.width, near.height)[:4]
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


def _places(width: int, height: int) -> Array:
    """Corners and centre of an image, px."""
    right, bottom = width - 1.0, height - 1.0
    return np.array([[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom], [right / 2, bottom / 2]])


def _describe(found: Registration, far_size: tuple[int, int], near_size: tuple[int, int]) -> Calibration:
    """All that is told of a calibration."""
    model, mapping = found.model, found.mapping
    places = _places(*near_size)
    places_far = mapping.to_specimen(places)
    by_parameters = model.differentiate(found.parameters, places_far)
    places_std = np.sqrt(np.einsum("nip,pq,niq->ni", by_parameters, found.covariance, by_parameters))
    # Places all over the near image, where the mapping is compared with a similarity.
    x, y = np.meshgrid(np.linspace(0, near_size[0] - 1, _GRID), np.linspace(0, near_size[1] - 1, _GRID))
    grid = mapping.to_specimen(np.column_stack([x.ravel(), y.ravel()]))

    def describe_similarity(parameters: Array) -> Array:
        similarity, _ = fit_similarity(model.build_mapping(parameters), grid)
        return _similarity_of(similarity)

    def list_homography(parameters: Array) -> Array:
        return model.build_mapping(parameters).homography.ravel()

    ratio, rotation, x0, y0 = describe_similarity(found.parameters)
    _, rest = fit_similarity(mapping, grid)
    distances = np.hypot(*rest.T)
    return Calibration(
        mapping=mapping,
        homography_std=_deviations(list_homography, found).reshape(3, 3),
        k1_std=float(np.sqrt(found.covariance[-1, -1])) if model.distorts else 0.0,
        ratio=float(ratio),
        rotation=float(rotation),
        offset=(float(x0), float(y0)),
        similarity_std=_deviations(describe_similarity, found),
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


def _deviations(function: Callable[[Array], Array], found: Registration) -> Array:
    """Standard deviations of a function of the parameters, by central differences."""
    slopes = []
    for k, value in enumerate(found.parameters):
        step = np.zeros_like(found.parameters)
        step[k] = 1e-6 * max(1.0, abs(float(value)))
        difference = function(found.parameters + step) - function(found.parameters - step)
        slopes.append(difference / (2 * step[k]))
    by_parameters = np.array(slopes).T
    variances = np.einsum("np,pq,nq->n", by_parameters, found.covariance, by_parameters)
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)))

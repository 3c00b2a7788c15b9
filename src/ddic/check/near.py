"""Whether a near camera's reference image shows what its mapping says."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import InputError
from ddic.images.source import ImageSource
from ddic.images.window import Window
from ddic.inputs.cameras import Camera, list_corners

LEAST_COEFFICIENT = 0.3
"""Correlation of a near reference image with the far one below which it does not show what its mapping says: unrelated
images stay below 0.1, right ones are above 0.8, where the far image resolves what the near one shows. A larger value
refuses more."""

COARSEST_SPECKLE = 15
"""Far-field pixels over which the mean is taken off before images are compared. A larger value compares light and holes
rather than speckle."""

LARGEST_PROBE = 1500
"""Side of the part of a near image that is compared, pixels. A larger value reads more of it."""

LEAST_HALF_PROBE = 4
"""Least half side of that part, far-field pixels, however much a near image magnifies."""


def check_near_mapping(far: Camera, near: Camera) -> None:
    """Check that a near camera's reference image shows what the far one shows there.

    Raises InputError where the mapping puts the near image outside the far one, mirrors it, or puts it in a wrong
    place.
    """
    far_path = far.reference.image.path
    place = f"{near.entry}: {near.reference.image.path}"
    low, high = _find_corners(near)
    seen = Window(int(low[0]), int(low[1]), int(high[0]) + 1, int(high[1]) + 1)
    common = seen.intersection(far.reference.extent)
    if common.width < 2 or common.height < 2:
        raise InputError(f"{place} lies outside the far-field image {far_path} by its mapping (columns {low[0]} "
                         f"to {high[0]}, rows {low[1]} to {high[1]}); find the mapping with ddic calibrate")
    if _measure_area_ratio(near) <= 0:
        raise InputError(f"{place}: its mapping turns the image over; mirror the images, or correct the mapping")
    coefficient = _correlate_references(far, near, common)
    if coefficient < LEAST_COEFFICIENT:
        raise InputError(f"{place} does not show what the far-field image {far_path} shows where its mapping "
                         f"puts it (correlation coefficient {coefficient:.2f}); find the mapping with ddic calibrate")


def _find_corners(near: Camera) -> tuple[IntArray, IntArray]:
    """First and last column and row, far-field pixels, that a near image reaches by its mapping."""
    seen = near.setup.mapping.to_specimen(list_corners(near.reference.image))
    low = np.ceil(seen.min(axis=0)).astype(np.int64)
    high = np.floor(seen.max(axis=0)).astype(np.int64)
    return low, high


def _measure_area_ratio(near: Camera) -> float:
    """Area of a far pixel in the middle of the near image, near pixels; negative where the mapping mirrors."""
    jacobians = near.setup.mapping.jacobian(near.setup.centre[None])
    return float(np.linalg.det(jacobians[0]))


def _correlate_references(far: Camera, near: Camera, common: Window) -> float:
    """Correlation coefficient of the reference images at far pixels near the middle of a window."""
    # Near pixels a far pixel, along a side.
    magnification = float(np.sqrt(_measure_area_ratio(near)))
    window = _choose_probe(near.setup.centre, magnification, common)
    seen = near.setup.mapping.to_image(_list_pixels(window))
    near_values, is_inside = _sample_blurred(near.reference.image, seen, magnification)
    far_values = np.asarray(far.reference.image.read(window), dtype=np.float32)
    near_speckle = _speckle(near_values.reshape(far_values.shape)).ravel()[is_inside]
    far_speckle = _speckle(far_values).ravel()[is_inside]
    if len(near_speckle) < 2 or near_speckle.std() == 0 or far_speckle.std() == 0:
        return 0.0
    return float(np.corrcoef(near_speckle, far_speckle)[0, 1])


def _choose_probe(centre: Array, magnification: float, common: Window) -> Window:
    """The part of a window that is compared: around the middle of the near image, far-field pixels."""
    half = max(int(LARGEST_PROBE / magnification / 2), LEAST_HALF_PROBE)
    x = int(np.clip(round(centre[0]), common.x0, common.x1 - 1))
    y = int(np.clip(round(centre[1]), common.y0, common.y1 - 1))
    return Window(x - half, y - half, x + half, y + half).intersection(common)


def _list_pixels(window: Window) -> Array:
    """Positions of all pixels of a window, row after row, (n, 2)."""
    x = np.arange(window.x0, window.x1)
    y = np.arange(window.y0, window.y1)
    columns, rows = np.meshgrid(x, y)
    return np.asarray(np.stack([columns.ravel(), rows.ravel()], axis=1), dtype=np.float64)


def _sample_blurred(image: ImageSource, points: Array, magnification: float) -> tuple[NDArray[np.float32], BoolArray]:
    """An image averaged over far pixels, at the pixels nearest to some points, (n,), and whether each lies in it."""
    low = np.floor(points.min(axis=0)).astype(int) - 1
    high = np.ceil(points.max(axis=0)).astype(int) + 2
    part = Window(int(low[0]), int(low[1]), int(high[0]), int(high[1])).clip(image.width, image.height)
    side = max(round(magnification), 1)
    values = cv2.blur(np.asarray(image.read(part), dtype=np.float32), (side, side))
    first_pixel = (part.x0, part.y0)
    last_pixel = (part.x1 - 1, part.y1 - 1)
    is_inside = ((points >= first_pixel) & (points <= last_pixel)).all(axis=1)
    last_place = (part.width - 1, part.height - 1)
    nearest = np.rint(np.clip(points - first_pixel, 0, last_place)).astype(int)
    return np.asarray(values[nearest[:, 1], nearest[:, 0]]), is_inside


def _speckle(image: NDArray[np.float32]) -> Array:
    """An image without what is wider than speckle: light and holes are alike in wrong places too."""
    return np.asarray(image - cv2.blur(image, (COARSEST_SPECKLE, COARSEST_SPECKLE)), dtype=np.float64)

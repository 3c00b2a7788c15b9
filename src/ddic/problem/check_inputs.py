"""All inputs of a case validated without solving, near-field images and where they lie among them."""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from ddic.case.loader import LoadedCase
from ddic.case.schema import Case
from ddic.errors import InputError
from ddic.images.window import Window
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from ddic.partition.ties import Tying
from ddic.problem.cameras import Camera, assign_cells, collect_cells, open_cameras, open_in_headers
from ddic.problem.check_case import CheckReport, check_case

LEAST_COEFFICIENT = 0.3
"""Correlation of a near reference image with the far one below which it does not show what its mapping says: unrelated
images stay below 0.1, right ones are above 0.8, where the far image resolves what the near one shows."""

COARSEST_SPECKLE = 15
"""Far-field pixels over which the mean is taken off before images are compared."""

LARGEST_PROBE = 1500
"""Side of the part of a near image that is compared, pixels."""


def check_inputs(loaded: LoadedCase) -> CheckReport:
    """Validate a case; raises InputError with the problems of all inputs, one line each."""
    return check_case(loaded, partial(_pixels_by_camera, loaded.case) if loaded.case.near else None)


def _pixels_by_camera(case: Case, mesh: Mesh, tying: Tying | None) -> NDArray[np.int64]:
    """Number of pixels of each cell in the images of the camera that measures it, (n_cells,); raises InputError."""
    cameras = open_cameras(case, open_in_headers)
    for near in cameras[1:]:
        _check_common_texture(cameras[0], near)
    labels = assign_cells(cameras, mesh, tying)
    counts = np.zeros(mesh.n_cells, dtype=np.int64)
    for measured in collect_cells(cameras, mesh, labels):
        counts[measured.cells] = rasterize(measured.seen).pixel_counts
    return counts


def _check_common_texture(far_camera: Camera, near_camera: Camera) -> None:
    """Refuse a near camera whose reference image does not show what its mapping says."""
    far, near, setup = far_camera.reference, near_camera.reference, near_camera.setup
    place = f"{near_camera.entry}: {near.image.path}"
    corner = np.array([[0.0, 0.0], [near.image.width - 1.0, near.image.height - 1.0]])
    seen = setup.mapping.to_specimen(np.array([[x, y] for x in corner[:, 0] for y in corner[:, 1]]))
    low, high = np.ceil(seen.min(axis=0)).astype(int), np.floor(seen.max(axis=0)).astype(int)
    common = Window(int(low[0]), int(low[1]), int(high[0]) + 1, int(high[1]) + 1).intersection(far.extent)
    if common.width < 2 or common.height < 2:
        raise InputError(f"{place} lies outside the far-field image {far.image.path} by its mapping (columns {low[0]} "
                         f"to {high[0]}, rows {low[1]} to {high[1]}); find the mapping with ddic calibrate")
    if np.linalg.det(setup.mapping.jacobian(setup.centre[None])[0]) <= 0:
        raise InputError(f"{place}: its mapping turns the image over; mirror the images, or correct the mapping")
    coefficient = _coefficient(far_camera, near_camera, common)
    if coefficient < LEAST_COEFFICIENT:
        raise InputError(f"{place} does not show what the far-field image {far.image.path} shows where its mapping "
                         f"puts it (correlation coefficient {coefficient:.2f}); find the mapping with ddic calibrate")


def _coefficient(far: Camera, near: Camera, common: Window) -> float:
    """Correlation coefficient of the far reference image with the near one, averaged over far pixels, in a window."""
    mapping = near.setup.mapping
    scale = float(np.sqrt(np.linalg.det(mapping.jacobian(near.setup.centre[None])[0])))
    half = max(int(LARGEST_PROBE / scale / 2), 4)
    x, y = (int(np.clip(round(c), low, high - 1)) for c, low, high in
            zip(near.setup.centre, (common.x0, common.y0), (common.x1, common.y1), strict=True))
    window = Window(x - half, y - half, x + half, y + half).intersection(common)
    columns, rows = np.meshgrid(np.arange(window.x0, window.x1), np.arange(window.y0, window.y1))
    seen = mapping.to_image(np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float64))
    image = near.reference.image
    low, high = np.floor(seen.min(axis=0)).astype(int) - 1, np.ceil(seen.max(axis=0)).astype(int) + 2
    part = Window(int(low[0]), int(low[1]), int(high[0]), int(high[1])).clipped(image.width, image.height)
    size = max(round(scale), 1)
    values = cv2.blur(np.asarray(image.read(part), dtype=np.float32), (size, size))
    inside = ((seen >= (part.x0, part.y0)) & (seen <= (part.x1 - 1, part.y1 - 1))).all(axis=1)
    nearest = np.rint(np.clip(seen - (part.x0, part.y0), 0, (part.width - 1, part.height - 1))).astype(int)
    shape = (window.height, window.width)
    a = _speckle(values[nearest[:, 1], nearest[:, 0]].reshape(shape)).ravel()[inside]
    b = _speckle(np.asarray(far.reference.image.read(window), dtype=np.float32)).ravel()[inside]
    if len(a) < 2 or a.std() == 0 or b.std() == 0:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


def _speckle(image: NDArray[np.float32]) -> NDArray[np.float64]:
    """An image without what is wider than speckle: light and holes are alike in wrong places too."""
    return np.asarray(image - cv2.blur(image, (COARSEST_SPECKLE, COARSEST_SPECKLE)), dtype=np.float64)

"""The residual image of each camera in the result file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.correlation import Band, Residual
from ddic.functionals.view import FrameView
from ddic.inputs.cameras import Camera
from ddic.io.hdf5_stream import ChunkGrid
from ddic.io.result_writer import ResultWriter
from ddic.parallel.team import require_held
from ddic.results.residual_image import Patch, pack_chunks, stream_chunks

if TYPE_CHECKING:
    from ddic.results.measurement import Measurement


def write_residual_images(measurement: Measurement, writer: ResultWriter | None) -> None:
    """Write the residual image of each camera; collective: every rank compresses its chunks, rank 0 stores them.

    Parameters
    ----------
    measurement : Measurement
        What was measured.
    writer : ResultWriter or None
        On rank 0.
    """
    for camera in measurement.cameras:
        _write_residual_image(measurement, camera, writer)


def _write_residual_image(measurement: Measurement, camera: Camera, writer: ResultWriter | None) -> None:
    team, image = measurement.team, camera.reference.image
    grid = ChunkGrid(image.width, image.height)
    team.build_on_root(lambda: require_held(writer).create_residual_image(grid))
    seen = _see_in_bands(measurement, camera.number, grid.shape[0])
    windows = [band.window for of_view in seen for band in of_view.bands]
    chunks = pack_chunks(team, grid, windows, _make_patches(measurement, camera.number, seen))
    stream_chunks(team, chunks, lambda chunk: require_held(writer).write_residual_chunk(chunk.number, chunk.data))


@dataclass(frozen=True)
class _SeenInBands:
    """A view of a subdomain with unknowns q, its residual sums, and the bands of rows in which it is drawn."""

    view: FrameView
    q: NDArray[np.float64]
    residual: Residual
    bands: list[Band]


def _see_in_bands(measurement: Measurement, camera: int, height: int) -> list[_SeenInBands]:
    """A camera's views of owned subdomains, in bands: images of whole subdomains are as large as reference images."""
    return [_SeenInBands(view, q, residual, view.view.correlation.split_bands(height))
            for of_subdomain, q, residuals in zip(measurement.whole.views, measurement.q,
                                                  measurement.evaluation.residuals, strict=True)
            for view, residual in zip(of_subdomain.views, residuals, strict=True) if view.camera == camera]


def _make_patches(measurement: Measurement, camera: int, seen: list[_SeenInBands]) -> Iterator[Patch]:
    """A camera's residual on each band, computed one by one."""
    for of_view in seen:
        correction = measurement.whole.find_correction(measurement.evaluation, camera, of_view.residual)
        images = of_view.view.compute_residual_bands(of_view.q, of_view.bands, *correction)
        for band, image in zip(of_view.bands, images, strict=True):
            yield Patch(band.window, image)

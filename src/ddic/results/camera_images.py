"""The residual image of each camera in the result file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from ddic.io.image_chunks import ChunkGrid
from ddic.io.result_writer import ResultWriter
from ddic.parallel.team import require_held
from ddic.problem.cameras import Camera
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
    windows = [view.view.correlation.reference.window
               for of_subdomain in measurement.model.views for view in of_subdomain.views
               if view.camera == camera.number]
    chunks = pack_chunks(team, grid, windows, _make_patches(measurement, camera.number))
    stream_chunks(team, chunks, lambda chunk: require_held(writer).write_residual_chunk(chunk.number, chunk.data))


def _make_patches(measurement: Measurement, camera: int) -> Iterator[Patch]:
    """A camera's residual on each owned subdomain, computed one by one."""
    model, evaluation = measurement.whole, measurement.evaluation
    for of_subdomain, q, residuals in zip(model.views, measurement.q, evaluation.residuals, strict=True):
        for view, residual in zip(of_subdomain.views, residuals, strict=True):
            if view.camera == camera:
                gain, offset = model.find_correction(evaluation, camera, residual)
                window = view.view.correlation.reference.window
                yield Patch(window, view.compute_residual_image(q, gain, offset))

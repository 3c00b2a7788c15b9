"""Rendering a pair of images whose displacement is known exactly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.window import Window
from ddic.synth.digitise import Digitiser, Stored
from ddic.synth.fields import DisplacementField
from ddic.synth.hole import Hole
from ddic.synth.inverse import reference_points
from ddic.synth.texture import SpeckleTexture
from ddic.synth.two_scale_texture import TwoScaleTexture

# Images are made square by square: temporary arrays stay in cache and memory does not grow with the image.
# The noise is drawn square by square too, so this number is part of what a seed means.
_SQUARE = 256


@dataclass(frozen=True)
class ImagePair:
    """Reference and deformed image, each (height, width), of type uint8, uint16 or float32."""

    reference: Stored
    deformed: Stored


class Pictured(Protocol):
    """What a camera sees before and after the motion, at any point of its picture."""

    def reference_grey(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Grey level f at points (n, 2), pixels, as fractions of full scale (n,)."""
        ...

    def deformed_grey(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Grey level g at points (n, 2), pixels, as fractions of full scale (n,)."""
        ...


@dataclass(frozen=True)
class Scene:
    """What the camera looks at: a textured plane, its motion, and a hole or none."""

    texture: SpeckleTexture | TwoScaleTexture
    field: DisplacementField
    hole: Hole | None = None

    def reference_grey(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Grey level f at points (n, 2), pixels, before the motion, as fractions of full scale (n,)."""
        x, y = points.T
        grey = self.texture.grey(x, y)
        return grey if self.hole is None else self.hole.cut(grey, x, y)

    def deformed_grey(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Grey level g at points y (n, 2) after the motion: f at the solution x of x + u(x) = y."""
        return self.reference_grey(reference_points(self.field, points))


def render_pair(texture: SpeckleTexture, field: DisplacementField, width: int, height: int, *,
                bit_depth: int = 8, noise: float = 0.0, seed: int = 0,
                hole: Hole | None = None) -> ImagePair:
    """Render f and g in memory so that f(x) = g(x + u(x)) holds without any interpolation.

    width, height: pixels; bit_depth: 8, 16 or 32 (float on 0..255); noise: standard deviation in 8-bit grey
    levels, independent in the two images; seed: of the noise; hole: cut out of the texture, or None.
    Raises InputError for impossible values or a field that folds the plane, ConvergenceError if the motion
    cannot be inverted to 1e-12 px.
    """
    bands = _bands(Scene(texture, field, hole), Digitiser(bit_depth, noise, seed), width, height)
    pairs = list(bands)
    return ImagePair(np.concatenate([pair.reference for pair in pairs]),
                     np.concatenate([pair.deformed for pair in pairs]))


def write_pair(path_reference: Path, path_deformed: Path, texture: SpeckleTexture,
               field: DisplacementField, width: int, height: int, *, bit_depth: int = 8,
               noise: float = 0.0, seed: int = 0, hole: Hole | None = None) -> None:
    """Write the images of ``render_pair`` to two uncompressed TIFF files, holding one band in memory.

    Arguments and errors as for ``render_pair``; also InputError if a file cannot be written.
    """
    write_images(path_reference, path_deformed, Scene(texture, field, hole), Digitiser(bit_depth, noise, seed),
                 width, height)


def write_images(path_reference: Path, path_deformed: Path, scene: Pictured, digitiser: Digitiser, width: int,
                 height: int, stream: int = 0) -> None:
    """Write what a camera sees of a scene to two uncompressed TIFF files, holding one band in memory.

    width, height: pixels; stream: of the reference image's noise, the deformed image's being the next.
    Raises InputError for impossible values, a field that folds the plane or a file that cannot be written.
    """
    bands = _bands(scene, digitiser, width, height, stream)
    try:
        reference = _EmptyTiff.create(path_reference, width, height, digitiser)
        deformed = _EmptyTiff.create(path_deformed, width, height, digitiser)
        for row, pair in zip(range(0, height, _SQUARE), bands, strict=True):
            reference.fill(row, pair.reference)
            deformed.fill(row, pair.deformed)
    except BaseException as error:
        _remove(path_reference, path_deformed)
        if isinstance(error, OSError):
            raise InputError(f"{error.filename or path_reference}: cannot be written: {error.strerror}; "
                             "choose a folder with write access and enough space") from error
        raise


def _remove(*paths: Path) -> None:
    """Remove files that would otherwise stay half written."""
    for path in paths:
        if path.is_file():
            path.unlink()


@dataclass(frozen=True)
class _EmptyTiff:
    """A TIFF file whose header and size are final; its rows lie one after the other from ``offset``."""

    path: Path
    offset: int

    @staticmethod
    def create(path: Path, width: int, height: int, digitiser: Digitiser) -> _EmptyTiff:
        import tifffile

        pixels = tifffile.memmap(path, shape=(height, width), dtype=digitiser.dtype,
                                 photometric="minisblack", metadata=None)
        return _EmptyTiff(path, int(pixels.offset))

    def fill(self, row: int, band: Stored) -> None:
        with self.path.open("r+b") as file:
            file.seek(self.offset + row * band[0].nbytes)
            file.write(band.tobytes())


def _bands(scene: Pictured, digitiser: Digitiser, width: int, height: int, stream: int = 0) -> Iterator[ImagePair]:
    """Bands of both images from top to bottom, each a row of squares."""
    if width < 1 or height < 1:
        raise InputError(f"image: size = {width}x{height}: must be at least 1x1 pixels")
    return (_band(scene, digitiser, width, y0, min(y0 + _SQUARE, height), stream)
            for y0 in range(0, height, _SQUARE))


def _band(scene: Pictured, digitiser: Digitiser, width: int, y0: int, y1: int, stream: int) -> ImagePair:
    windows = [Window(x0, y0, min(x0 + _SQUARE, width), y1) for x0 in range(0, width, _SQUARE)]
    pairs = [_square(scene, digitiser, window, stream) for window in windows]
    return ImagePair(np.concatenate([pair.reference for pair in pairs], axis=1),
                     np.concatenate([pair.deformed for pair in pairs], axis=1))


def _square(scene: Pictured, digitiser: Digitiser, window: Window, stream: int) -> ImagePair:
    x, y = np.meshgrid(np.arange(window.x0, window.x1), np.arange(window.y0, window.y1))
    points = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    stored = [digitiser.store(grey.reshape(x.shape), (image, window.x0, window.y0))
              for image, grey in enumerate((scene.reference_grey(points), scene.deformed_grey(points)), stream)]
    return ImagePair(*stored)

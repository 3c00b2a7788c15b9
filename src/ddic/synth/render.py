"""Rendering a pair of images whose displacement is known exactly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ddic.images.window import Window
from ddic.io.replace_on_exit import NewFiles, begin_files
from ddic.synth.digitise import Stored
from ddic.synth.fields import DisplacementField
from ddic.synth.hole import Hole
from ddic.synth.inverse import find_reference_points
from ddic.synth.picture import Picture
from ddic.synth.speckle_texture import SpeckleTexture
from ddic.synth.two_scale_texture import TwoScaleTexture

# Images are made square by square: temporary arrays stay in cache and memory does not grow with the image.
# The noise is drawn square by square too, so this number is part of what a seed means.
_SQUARE = 256


@dataclass(frozen=True)
class ImagePair:
    """Reference and deformed image.

    Attributes
    ----------
    reference, deformed : (height, width) array
        Stored grey levels: uint8, uint16 or float32.
    """

    reference: Stored
    deformed: Stored


class Pictured(Protocol):
    """What a camera sees before and after the motion, at any point of its picture."""

    def reference_grey(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Evaluate the grey level f before the motion.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n,) array
            Fractions of full scale.
        """
        ...

    def deformed_grey(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Evaluate the grey level g after the motion.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n,) array
            Fractions of full scale.
        """
        ...


@dataclass(frozen=True)
class Scene:
    """What the camera looks at.

    Attributes
    ----------
    texture : SpeckleTexture or TwoScaleTexture
        Paint of the plane.
    field : DisplacementField
        Its motion.
    hole : Hole, optional
        Cut out of the paint.
    """

    texture: SpeckleTexture | TwoScaleTexture
    field: DisplacementField
    hole: Hole | None = None

    def reference_grey(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Evaluate the grey level f before the motion.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n,) array
            Fractions of full scale.
        """
        x, y = points.T
        grey = self.texture.grey(x, y)
        return grey if self.hole is None else self.hole.cut(grey, x, y)

    def deformed_grey(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Evaluate the grey level g after the motion: f at the solution x of x + u(x) = y.

        Parameters
        ----------
        points : (n, 2) array
            The y, pixels.

        Returns
        -------
        (n,) array
            Fractions of full scale.
        """
        return self.reference_grey(find_reference_points(self.field, points))


def render_pair(scene: Pictured, picture: Picture, stream: int = 0) -> ImagePair:
    """Render f and g in memory so that f(x) = g(x + u(x)) holds without any interpolation.

    Parameters
    ----------
    scene : Pictured
        What the camera sees.
    picture : Picture
        Size, bit depth and noise of both images; the noise is independent in the two.
    stream : int, optional
        Of the reference image's noise; the deformed image's is the next.

    Returns
    -------
    ImagePair
        The images.

    Raises
    ------
    InputError
        For a field that folds the plane.
    ConvergenceError
        Where the motion cannot be inverted to 1e-12 px.
    """
    bands = list(_bands(scene, picture, stream))
    reference = np.concatenate([band.reference for band in bands])
    deformed = np.concatenate([band.deformed for band in bands])
    return ImagePair(reference, deformed)


def write_pair(paths: tuple[Path, Path], scene: Pictured, picture: Picture, stream: int = 0,
               files: NewFiles | None = None) -> None:
    """Write the images of ``render_pair`` to two uncompressed TIFF files, holding one band in memory.

    Parameters
    ----------
    paths : (Path, Path)
        Of the reference and of the deformed image.
    scene : Pictured
        What the camera sees.
    picture : Picture
        Size, bit depth and noise of both images.
    stream : int, optional
        Of the reference image's noise; the deformed image's is the next.
    files : NewFiles, optional
        With which they take their names; by default the two do so by themselves.

    Raises
    ------
    InputError
        For a field that folds the plane, or a folder that cannot be written to; no half-written file stays.
    OSError
        Where the disk does not take them.
    ConvergenceError
        Where the motion cannot be inverted to 1e-12 px.
    """
    with begin_files(files) as new:
        reference, deformed = (_create_tiff(new.begin(path), picture) for path in paths)
        first_rows = range(0, picture.height, _SQUARE)
        for row, band in zip(first_rows, _bands(scene, picture, stream), strict=True):
            reference.fill(row, band.reference)
            deformed.fill(row, band.deformed)


@dataclass(frozen=True)
class _EmptyTiff:
    """A TIFF file whose header and size are final; its rows lie one after the other from ``offset``."""

    path: Path
    offset: int

    def fill(self, row: int, band: Stored) -> None:
        """Write whole rows, the first of which is ``row``."""
        with self.path.open("r+b") as file:
            file.seek(self.offset + row * band[0].nbytes)
            file.write(band.tobytes())


def _create_tiff(path: Path, picture: Picture) -> _EmptyTiff:
    """Make a file of the picture's size and type."""
    import tifffile

    shape = (picture.height, picture.width)
    pixels = tifffile.memmap(path, shape=shape, dtype=picture.digitiser.dtype, photometric="minisblack", metadata=None)
    return _EmptyTiff(path, int(pixels.offset))


def _bands(scene: Pictured, picture: Picture, stream: int) -> Iterator[ImagePair]:
    """Bands of both images from top to bottom, each a row of squares."""
    for y0 in range(0, picture.height, _SQUARE):
        y1 = min(y0 + _SQUARE, picture.height)
        squares = []
        for x0 in range(0, picture.width, _SQUARE):
            window = Window(x0, y0, min(x0 + _SQUARE, picture.width), y1)
            squares.append(_render_square(scene, picture, window, stream))
        reference = np.concatenate([square.reference for square in squares], axis=1)
        deformed = np.concatenate([square.deformed for square in squares], axis=1)
        yield ImagePair(reference, deformed)


def _render_square(scene: Pictured, picture: Picture, window: Window, stream: int) -> ImagePair:
    """Both images in a window."""
    x, y = np.meshgrid(np.arange(window.x0, window.x1), np.arange(window.y0, window.y1))
    points = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    reference = scene.reference_grey(points).reshape(x.shape)
    deformed = scene.deformed_grey(points).reshape(x.shape)
    store = picture.digitiser.store
    return ImagePair(store(reference, (stream, window.x0, window.y0)),
                     store(deformed, (stream + 1, window.x0, window.y0)))

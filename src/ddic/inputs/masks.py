"""Pixels of a camera's images that are left out: by the image of a mask, by shapes, for their saturation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.case.schema import CameraSection, Shape, ShapeSection
from ddic.errors import InputError, Problems
from ddic.images.grey_levels import find_saturation
from ddic.images.source import ImageSource, SizedImage
from ddic.images.sub_image import MaskedSource
from ddic.images.window import Window
from ddic.mesh.holes import Circle, Polygon, convert_region

Opener = Callable[[Path], ImageSource]
"""Opens an image file."""


def exclude_masked(image: ImageSource, section: CameraSection, mask: Path | None, opener: Opener,
                   shapes: Sequence[Shape] = ()) -> MaskedSource:
    """Leave out of one of a section's images what is saturated, if asked for, and what a mask and shapes hide."""
    saturated_from = None
    if section.exclude_saturated:
        saturated_from = find_saturation(image) if section.saturation is None else section.saturation
    below = None if mask is None else opener(mask)
    return MaskedSource(image, draw_mask(shapes, image.extent, "masked", below), saturated_from)


def exclude_from_reference(image: ImageSource, section: CameraSection, opener: Opener) -> MaskedSource:
    """The same of a section's reference image."""
    return exclude_masked(image, section, section.reference_mask, opener, section.masked)


@dataclass(frozen=True)
class DrawnMask(SizedImage):
    """A mask of shapes, drawn window by window: 0 inside of them and where the one below is, else 1.

    Attributes
    ----------
    path : Path
        What messages call it.
    bounds : Window
        Of the image that it belongs to.
    shapes : tuple of Circle or Polygon
        What it hides.
    below : ImageSource or None
        The image of another mask.
    saturation : float or None
        No level of a mask is.
    """

    path: Path
    bounds: Window
    shapes: tuple[Circle | Polygon, ...]
    below: ImageSource | None = None
    saturation: float | None = None

    @property
    def extent(self) -> Window:
        """The box of all its pixels."""
        return self.bounds

    def read(self, window: Window) -> NDArray[np.uint8]:
        """Draw a window; raises ValueError where it leaves the image or is empty."""
        self.extent.locate_inside(window)
        used = np.ones(window.shape, dtype=bool) if self.below is None else self.below.read(window) != 0
        for shape in self.shapes:
            part = _bound(shape, window)
            if part.n_pixels:
                used[window.locate(part)] &= ~shape.find_pixels(part)
        return np.asarray(used, dtype=np.uint8)


def _bound(shape: Circle | Polygon, window: Window) -> Window:
    """The pixels of a window in the box about a shape."""
    x0, y0, x1, y1 = shape.box
    lower = np.clip(np.ceil((x0, y0)), window.lower, window.upper)
    upper = np.clip(np.floor((x1, y1)) + 1, window.lower, window.upper)
    return Window.between(lower, upper)


def draw_mask(shapes: Sequence[Shape], extent: Window, name: str, below: ImageSource | None = None,
              ) -> ImageSource | None:
    """Draw the mask of shapes over another one, ``below``, which is the mask where there is no shape.

    ``extent`` is the image that they belong to, ``name`` the key that holds them. Raises InputError with a line for
    each shape that crosses itself, or whose box holds no pixel.
    """
    if not shapes:
        return below
    problems, drawn = Problems(), []
    for k, shape in enumerate(shapes):
        with problems.gathered():
            drawn.append(_convert(shape, f"{name}[{k}]"))
            if not _bound(drawn[-1], extent).n_pixels:
                raise InputError(f"{name}[{k}]: holds no pixel of the image of {extent.width} x {extent.height} px; "
                                 "move it, or leave it out")
    problems.require_none()
    return DrawnMask(Path(name), extent, tuple(drawn), below)


def _convert(shape: Shape, name: str) -> Circle | Polygon:
    if isinstance(shape, ShapeSection):
        outline = convert_region(shape.region, name)
        assert outline is not None
        return outline
    x0, y0, x1, y1 = shape
    if not (x0 < x1 and y0 < y1):
        raise InputError(f"{name} = {list(shape)}: expected x0 < x1 and y0 < y1")
    return Polygon.from_box(shape)

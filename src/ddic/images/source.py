"""What the rest of the program needs to know of an image, wherever its pixels come from."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray

from ddic.images.window import Window


class ImageSource(Protocol):
    """A grey-level image that is read window by window.

    path: name for messages and checksums; width, height: pixels;
    saturation: largest grey level that the integer type holds, None for float images.
    """

    @property
    def path(self) -> Path:
        """Where the image comes from."""
        ...

    @property
    def width(self) -> int:
        """Number of columns."""
        ...

    @property
    def height(self) -> int:
        """Number of rows."""
        ...

    @property
    def saturation(self) -> float | None:
        """Largest grey level of an integer image, None for a float image."""
        ...

    def read(self, window: Window) -> NDArray[Any]:
        """Grey levels of a window that lies in the image, shape (window.height, window.width), own type."""
        ...

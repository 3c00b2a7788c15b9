"""What the rest of the program needs to know of an image, wherever its pixels come from."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray

from ddic.images.window import Window


class ImageSource(Protocol):
    """A grey-level image that is read window by window.

    Its path is its name in messages and checksums.
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
        """Read a window.

        Parameters
        ----------
        window : Window
            Inside the image.

        Returns
        -------
        (window.height, window.width) array
            Grey levels in their own type.
        """
        ...

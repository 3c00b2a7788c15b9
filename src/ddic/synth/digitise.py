"""From exact grey levels to the values that an image stores: noise, clipping and rounding."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError

Stored = NDArray[Any]

_FULL_SCALE = {8: 255.0, 16: 65535.0, 32: 255.0}
_DTYPES: dict[int, np.dtype[Any]] = {
    8: np.dtype(np.uint8), 16: np.dtype(np.uint16), 32: np.dtype(np.float32)}


@dataclass(frozen=True)
class Digitiser:
    """Camera model: full scale, additive Gaussian noise, rounding.

    Attributes
    ----------
    bit_depth : int
        8 (0..255), 16 (0..65535), or 32 for float32 values on the scale 0..255, not rounded.
    noise : float
        Standard deviation in grey levels of an 8-bit image, whatever the bit depth.
    seed : int
        Of the noise, at least 0.

    Raises
    ------
    InputError
        For another bit depth, a negative noise or a negative seed.
    """

    bit_depth: int = 8
    noise: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.bit_depth not in _DTYPES:
            raise InputError(f"image: bit_depth = {self.bit_depth}: must be 8, 16 or 32 (float)")
        if not (self.noise >= 0 and math.isfinite(self.noise)):
            raise InputError(f"image: noise = {self.noise}: must be at least 0 grey levels")
        if self.seed < 0:
            raise InputError(f"image: seed = {self.seed}: must be at least 0")

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the stored values: uint8, uint16 or float32."""
        return _DTYPES[self.bit_depth]

    def store(self, grey: NDArray[np.float64], stream: tuple[int, ...]) -> Stored:
        """Turn grey levels into stored values.

        Parameters
        ----------
        grey : array
            Of any shape, fractions of full scale.
        stream : tuple of int
            Numbers that, with the seed, fix the noise; different streams are independent.

        Returns
        -------
        array
            Of the same shape and of type ``dtype``.
        """
        full_scale = _FULL_SCALE[self.bit_depth]
        levels = grey * full_scale
        if self.noise > 0:
            generator = np.random.default_rng([self.seed, *stream])
            levels += self.noise * (full_scale / 255.0) * generator.standard_normal(levels.shape)
        np.clip(levels, 0.0, full_scale, out=levels)
        if self.bit_depth != 32:
            np.rint(levels, out=levels)
        return levels.astype(self.dtype)

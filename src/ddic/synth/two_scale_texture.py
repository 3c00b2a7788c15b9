"""One painted surface seen at two magnifications: coarse spots that both cameras see, fine spots that one resolves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ddic.errors import InputError
from ddic.synth.speckle_texture import SpeckleTexture


@dataclass(frozen=True)
class TwoScaleTexture:
    """Coarse and fine speckles side by side in one paint.

    Averaged over spots of the fine speckles the grey level is that of ``coarse`` with 1 - fine_share of its contrast.

    Attributes
    ----------
    coarse, fine : SpeckleTexture
        Speckles, both in the specimen's frame.
    fine_share : float
        Of the fine speckles in the contrast, between 0 and 1.

    Raises
    ------
    InputError
        For a share that is not between 0 and 1.
    """

    coarse: SpeckleTexture
    fine: SpeckleTexture
    fine_share: float = 0.4

    def __post_init__(self) -> None:
        if not 0 <= self.fine_share <= 1:
            raise InputError(f"texture: fine_share = {self.fine_share}: must lie between 0 and 1")

    def grey(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Evaluate the grey level.

        Parameters
        ----------
        x, y : array_like
            Points, pixels of the specimen's frame.

        Returns
        -------
        array
            Fractions of full scale, of the shape of x and y.
        """
        coarse = np.tanh(self.coarse.evaluate(x, y))
        fine = np.tanh(self.fine.evaluate(x, y))
        return np.asarray(0.5 - 0.45 * ((1 - self.fine_share) * coarse + self.fine_share * fine))


def two_scale_texture(ratio: float, seed: int = 0, speckle_size: float = 1.0,
                      fine_share: float = 0.4) -> TwoScaleTexture:
    """Paint coarse spots of about 5 far pixels and fine ones of about 5 near pixels.

    Parameters
    ----------
    ratio : float
        Near pixels per far pixel.
    seed : int, optional
        Of the speckles.
    speckle_size : float, optional
        Magnification of both kinds of spots.
    fine_share : float, optional
        Of the fine spots in the contrast.

    Returns
    -------
    TwoScaleTexture
        In the specimen's frame.

    Raises
    ------
    InputError
        For a value out of range.
    """
    # Far from the small seeds that make other specimens.
    fine_seed = (seed + 2**63) % 2**64
    coarse = SpeckleTexture(seed, speckle_size)
    fine = SpeckleTexture(fine_seed, speckle_size / ratio)
    return TwoScaleTexture(coarse, fine, fine_share)

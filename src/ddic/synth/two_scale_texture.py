"""One painted surface seen at two magnifications: coarse spots that both cameras see, fine spots that one resolves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ddic.errors import InputError
from ddic.synth.texture import SpeckleTexture


@dataclass(frozen=True)
class TwoScaleTexture:
    """Coarse and fine speckles side by side in one paint.

    coarse, fine: speckles, both in the specimen's frame; fine_share: of the contrast, between 0 and 1.
    Averaged over spots of the fine speckles the grey level is that of ``coarse`` with 1 - fine_share of its contrast.
    Raises InputError for a share that is not between 0 and 1.
    """

    coarse: SpeckleTexture
    fine: SpeckleTexture
    fine_share: float = 0.4

    def __post_init__(self) -> None:
        if not 0 <= self.fine_share <= 1:
            raise InputError(f"texture: fine_share = {self.fine_share}: must lie between 0 and 1")

    def grey(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Grey level at points x, y (pixels of the specimen's frame) as a fraction of full scale."""
        coarse, fine = np.tanh(self.coarse.evaluate(x, y)), np.tanh(self.fine.evaluate(x, y))
        return np.asarray(0.5 - 0.45 * ((1 - self.fine_share) * coarse + self.fine_share * fine))


def two_scale_texture(ratio: float, seed: int = 0, speckle_size: float = 1.0,
                      fine_share: float = 0.4) -> TwoScaleTexture:
    """Coarse spots of about 5 far pixels and fine ones of about 5 near pixels.

    ratio: near pixels per far pixel; seed: of the speckles; speckle_size: magnification of both; fine_share: of the
    contrast.
    Raises InputError for a value out of range.
    """
    coarse = SpeckleTexture(seed, speckle_size)
    # Far from the small seeds that make other specimens.
    return TwoScaleTexture(coarse, SpeckleTexture((seed + 2**63) % 2**64, speckle_size / ratio), fine_share)

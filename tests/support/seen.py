"""Cells as a frame shows them, made up."""

from __future__ import annotations

from typing import Any

import numpy as np

from ddic.visibility.seen_cells import SeenCells


def make_seen(n_cells: int = 100, **given: Any) -> SeenCells:
    """Cells of 256 px that show the same speckle in both images with noise of variance 8, but what is given."""
    usual = {"n_pixels": 256.0, "variance": 8.0, "texture": 200.0, "mean_f": 128.0, "mean_g": 128.0, "spread_f": 40.0,
             "spread_g": 40.0, "coefficient": 0.99}
    # A translation explains nothing, unless that is given too.
    values = {**usual, "unexplained": given.get("variance", usual["variance"]), **given}
    return SeenCells(**{name: np.array(np.broadcast_to(value, n_cells), dtype=float)
                        for name, value in values.items()})

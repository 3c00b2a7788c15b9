"""Print what the notched test shows of its crack: openings, and the residual with the line and without it.

python compare.py FOLDER, where run.sh has left its results.
"""

import sys
from pathlib import Path

import numpy as np

import ddic

NOTCH = 170.0
"""Column at which the notch ends, pixels."""

LINE, HALF = 605.0, 8.0
"""Row of the line, and half of an element, pixels."""

BEHIND = (25, 55, 80)
"""Distances from the notch at which the opening is told, pixels."""


def measure_residual(result: ddic.Result) -> float:
    """RMS of the residual in the elements on the crack, from the notch on for 80 px; grey levels."""
    x, y = result.mesh.centroids.T
    on_crack = (np.abs(y - LINE) < HALF) & (x > NOTCH) & (x < NOTCH + max(BEHIND))
    return float(np.sqrt(np.nanmean(result.fields["residual_rms"][on_crack] ** 2)))


def main(folder: Path) -> None:
    series = zip((60, 120), ddic.open_series(folder / "result.vtkhdf"),
                 ddic.open_series(folder / "continuous.vtkhdf"), strict=True)
    for image, result, continuous in series:
        opening = ddic.measure_opening(result)
        apart = [opening.normal[np.abs(opening.points[:, 0] - NOTCH - behind) < 5].mean() for behind in BEHIND]
        one, two, three = apart
        print(f"frame {image}: open by {one:.2f}, {two:.2f} and {three:.2f} px, 25, 55 and 80 px behind the notch; "
              f"residual on it {measure_residual(result):.0f} grey levels, {measure_residual(continuous):.0f} with "
              "continuous elements")


main(Path(sys.argv[1]))

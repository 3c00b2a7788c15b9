"""The bar of this example: its images, and how far the measured frames are from what they show.

python bar.py picture FOLDER writes a reference image and eight frames after it; python bar.py compare FOLDER prints the
strain in the middle of the bar and the error of each measured frame.
"""

import math
import sys
from functools import partial
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray
from scipy.special import erf

import ddic

Array = NDArray[np.float64]

SIZE = (480, 160)
N_FRAMES = 8
CENTRE = np.array([239.5, 79.5])
WIDTH = 60.0
POISSON = 0.3


def find_strain(points: Array, number: int) -> Array:
    """Strain along the bar: even, with more of it in the middle."""
    share = number / N_FRAMES
    x = points[:, 0] - CENTRE[0]
    return np.asarray(0.012 * share + 0.03 * share**3 * np.exp(-((x / WIDTH) ** 2)))


def displace(points: Array, number: int) -> Array:
    share = number / N_FRAMES
    x, y = (points - CENTRE).T
    along = 0.012 * share * x + 0.03 * share**3 * WIDTH * math.sqrt(math.pi) / 2 * erf(x / WIDTH)
    return np.column_stack([along, -POISSON * find_strain(points, number) * y])


def picture(folder: Path) -> None:
    for number in range(1, N_FRAMES + 1):
        # One seed: the reference image is the same in all pairs.
        reference, deformed = ddic.make_synthetic_pair(partial(displace, number=number), SIZE, noise=1, seed=12)
        tifffile.imwrite(folder / "reference.tif", reference)
        tifffile.imwrite(folder / f"frame_{number}.tif", deformed)


def compare(folder: Path) -> None:
    series = ddic.open_series(folder / "series.vtkhdf")
    for number, time, result in zip(series.numbers, series.times, series, strict=True):
        error = result.displacement - displace(result.mesh.nodes, int(number))
        middle = np.hypot(*(result.mesh.nodes - CENTRE).T) < 16
        strain = result.fields["nodal_strain_infinitesimal"][middle, 0].mean()
        exact = find_strain(result.mesh.nodes[middle], int(number)).mean()
        print(f"frame {number}, {time:.1f} s: strain in the middle {strain:.4f}, exact {exact:.4f}; "
              f"RMS error {np.sqrt((error**2).mean()):.4f} px per component")


{"picture": picture, "compare": compare}[sys.argv[1]](Path(sys.argv[2]))

"""Measure a large motion: tens of pixels and a rotation between the images.

Nothing has to be guessed: a rigid shift is found by correlating whole images, then coarse images are measured before
fine ones. That finds shifts of any size; of rotation and strain, on speckle as fine as here, only some five pixels
across the region. A motion that is not found ends in ddic.ConvergenceError; then measure frames in between (frames.py).

    python examples/large_motion.py

prints

    the corners move by 28 to 38 px
    rotation 1.500 degrees
    RMS error 0.0060 px
"""

import numpy as np
from numpy.typing import NDArray

import ddic

ANGLE = np.radians(1.5)
CENTRE: NDArray[np.float64] = np.array([200.0, 200.0])
SHIFT: NDArray[np.float64] = np.array([27.4, -18.2])


def turn(points: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y = (points - CENTRE).T
    cosine, sine = np.cos(ANGLE), np.sin(ANGLE)
    turned = np.column_stack([cosine * x - sine * y, sine * x + cosine * y])
    return np.asarray(CENTRE + turned + SHIFT - points)


images = ddic.make_synthetic_pair(turn, (400, 400), noise=1, seed=16)
mesh = ddic.structured_mesh((60, 60, 340, 340), element_size=20)
result = ddic.measure(images, mesh)

corners = np.array([[60, 60], [340, 60], [340, 340], [60, 340]], dtype=float)
lengths = np.linalg.norm(result.at(corners), axis=1)
print(f"the corners move by {lengths.min():.0f} to {lengths.max():.0f} px")

# The rotation that fits all nodes best.
before = result.mesh.nodes - result.mesh.nodes.mean(axis=0)
after = before + result.displacement - result.displacement.mean(axis=0)
turned = np.arctan2((before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]).sum(), (before * after).sum())
print(f"rotation {np.degrees(turned):.3f} degrees")

error = result.displacement - turn(result.mesh.nodes)
print(f"RMS error {np.sqrt((error**2).mean()):.4f} px")

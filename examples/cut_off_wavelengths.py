"""Choose the cut-off wavelength: what it takes from the noise, and what from the measurement.

The regularization is a low-pass filter made of mechanics: what is longer than the cut-off wavelength l_c is measured by
the images, what is shorter follows from equilibrium. So noise falls as l_c grows, and so does whatever is short and not
in equilibrium, here a wave of shear of 100 px. Half of such a wave is left where its length is 0.87 l_c.

    python examples/cut_off_wavelengths.py

prints

    l_c [px]  noise [px]  left of the wave
          30     0.0105              1.04
          60     0.0042              0.97
         115     0.0019              0.51
         230     0.0007              0.05
"""

import numpy as np
from numpy.typing import NDArray

import ddic

SIZE = (400, 400)
AMPLITUDE, WAVELENGTH = 0.5, 100


def wave(points: NDArray[np.float64]) -> NDArray[np.float64]:
    u_y = AMPLITUDE * np.sin(2 * np.pi * points[:, 0] / WAVELENGTH)
    return np.column_stack([np.zeros_like(u_y), u_y])


# One seed: both frames have the same reference image.
reference, moved = ddic.make_synthetic_pair(wave, SIZE, noise=3, seed=4)
_, still = ddic.make_synthetic_pair(np.zeros_like, SIZE, noise=3, seed=4)

mesh = ddic.structured_mesh((20, 20, 380, 380), element_size=10)
print("l_c [px]  noise [px]  left of the wave")
for l_c in (30, 60, 115, 230):
    with ddic.prepare(reference, mesh, regularization={"cut_off_wavelength": l_c}) as session:
        noise = session.measure(still)
        measured = session.measure(moved)
    # Away from the sides of the mesh, where equilibrium is not known, a whole number of waves.
    inside = (np.abs(measured.mesh.nodes - 200) <= 100).all(axis=1)
    exact = wave(measured.mesh.nodes)[inside, 1]
    left = measured.displacement[inside, 1] @ exact / (exact @ exact)
    print(f"{l_c:8d}  {noise.displacement[inside].std():9.4f}  {left:16.2f}")

"""Measure many frames of a test in one session.

What follows from the reference image alone, mesh, matrices and their factors, is made once; then each frame takes only
its iterations. Each frame starts from the one before it, as in a test that loads slowly.

    python examples/frames.py

prints

    frame 1: strain yy 0.0020
    frame 2: strain yy 0.0040
    frame 3: strain yy 0.0060
    frame 4: strain yy 0.0080
    frame 5: strain yy 0.0100
    4 subdomains, factorised 4 times
"""

import numpy as np
from numpy.typing import NDArray

import ddic


def pull(points: NDArray[np.float64], strain: float) -> NDArray[np.float64]:
    x, y = (points - 125).T
    return strain * np.column_stack([-0.3 * x, y])


def take_picture(strain: float) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    # One seed: the reference image is the same in all pairs.
    return ddic.make_synthetic_pair(lambda points: pull(points, strain), (250, 250), noise=1, seed=7)


reference, _ = take_picture(0.0)
mesh = ddic.structured_mesh((20, 20, 230, 230), element_size=15)

with ddic.prepare(reference, mesh, regularization={"cut_off_wavelength": 60}, solver={"subdomains": 4}) as session:
    for number in range(1, 6):
        _, deformed = take_picture(0.002 * number)
        result = session.measure(deformed, from_last=number > 1)
        strain = result.fields["strain_infinitesimal"][:, 1].mean()
        print(f"frame {number}: strain yy {strain:.4f}")
    print(f"{result.n_subdomains} subdomains, factorised {session.n_factorized} times")

"""Measure with several processes: the same script under mpirun.

Every process runs the script and gives ddic the same images and mesh; ddic deals out the subdomains, and every process
gets the whole result. Only one of them should print or draw.

    mpirun -n 2 python -m mpi4py examples/mpirun_script.py

prints (python -m mpi4py ends all processes if one of them fails)

    2 processes, 4 subdomains
    mean displacement (0.301, -0.201) px
"""

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

import ddic


def translation(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.tile([0.3, -0.2], (len(points), 1))


# Files are better than arrays where images are large: each process then reads its own part.
images = ddic.make_synthetic_pair(translation, (300, 240), noise=1, seed=11)
mesh = ddic.structured_mesh((20, 20, 280, 220), element_size=20)
result = ddic.measure(images, mesh, regularization={"cut_off_wavelength": 80}, solver={"subdomains": 4})

if MPI.COMM_WORLD.rank == 0:
    u_x, u_y = result.displacement.mean(axis=0)
    print(f"{MPI.COMM_WORLD.size} processes, {result.n_subdomains} subdomains")
    print(f"mean displacement ({u_x:.3f}, {u_y:.3f}) px")

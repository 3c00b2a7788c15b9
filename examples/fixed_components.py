"""Hold some components of the displacement: rails along which the specimen slides.

What is known need not be measured. Here every third node is known not to move along y, so it has one unknown where
others have two: one column of the matrix from unknowns to displacements for each component that is free.

    python examples/fixed_components.py [method]
    mpirun -n 2 python examples/fixed_components.py [method]

where the method is dual (default), assembled, conjugate_gradient or monolithic (one rank); all find the same. It prints

    216 nodes, 360 unknowns; strain xx 0.01002
    u_y at nodes that are held: 0.0000 px, at the others 0.0083 px RMS
"""

import sys

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

import ddic

HELD_EVERY = 3


def slide(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([0.3 + 0.01 * (points[:, 0] - 150), np.zeros(len(points))])


def kinematics(mesh: ddic.Mesh) -> ddic.LinearRegion:
    is_free = np.ones(mesh.nodes.shape, dtype=bool)
    is_free[::HELD_EVERY, 1] = False
    free = np.flatnonzero(is_free)
    # Rows: x and y of one node after the other. Columns: unknowns.
    matrix = sparse.csr_matrix((np.ones(len(free)), (free, np.arange(len(free)))), (mesh.n_dofs, len(free)))
    return ddic.LinearRegion(mesh, matrix)


IMAGES = ddic.make_synthetic_pair(slide, (300, 200), noise=1, seed=6)
MESH = ddic.structured_mesh((20, 20, 280, 180), element_size=15)


if __name__ == "__main__":
    method = sys.argv[1] if len(sys.argv) > 1 else "dual"
    solver = {"method": method} if method == "monolithic" else {"method": method, "subdomains": 4}
    result = ddic.measure(IMAGES, MESH, kinematics=kinematics, solver=solver)
    u_y = result.displacement[:, 1]
    held = np.arange(result.mesh.n_nodes) % HELD_EVERY == 0
    if MPI.COMM_WORLD.rank == 0:
        strain = result.fields["strain_infinitesimal"][:, 0].mean()
        print(f"{len(u_y)} nodes, {2 * len(u_y) - held.sum()} unknowns; strain xx {strain:.5f}")
        print(f"u_y at nodes that are held: {np.abs(u_y[held]).max():.4f} px, "
              f"at the others {np.sqrt((u_y[~held]**2).mean()):.4f} px RMS")

"""Measure the displacement between two images held in arrays.

The shortest measurement: two arrays of grey levels and a mesh of square elements. The images are made here, from a
stretch that is known at every point, with noise of one grey level; yours would come from any image library.

    python examples/measure_arrays.py

prints

    strain xx 0.00998, yy -0.00299
    RMS error 0.0064 px over 154 nodes
"""

import numpy as np
from numpy.typing import NDArray

import ddic


def stretch(points: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y = points.T
    return np.column_stack([0.4 + 0.010 * (x - 150), -0.2 - 0.003 * (y - 120)])


# Two arrays (rows, columns). x runs along columns, y down the rows; the first pixel's centre is (0, 0).
reference, deformed = ddic.make_synthetic_pair(stretch, (300, 240), noise=1, seed=1)

mesh = ddic.structured_mesh((20, 20, 280, 220), element_size=20)
result = ddic.measure((reference, deformed), mesh)

# Tensors hold xx, yy, zz, xy, yz, xz, one row for each element.
strain = result.fields["strain_infinitesimal"].mean(axis=0)
print(f"strain xx {strain[0]:.5f}, yy {strain[1]:.5f}")

# Vectors at the nodes, pixels.
error = result.displacement - stretch(result.mesh.nodes)
print(f"RMS error {np.sqrt((error**2).mean()):.4f} px over {result.mesh.n_nodes} nodes")

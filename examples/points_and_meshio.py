"""Read the displacement at any point, and hand the fields to other programs.

A virtual extensometer: two points, each displaced as the shape functions of its element say; a point outside the mesh,
or in a hole, has no displacement (nan). Then the fields go to meshio, which writes some forty formats, and to PyVista
(`pip install pyvista`), which draws them.

    python examples/points_and_meshio.py

prints

    gauge length 200.0 px, elongation 1.599 px, strain 0.00800
    outside the mesh: nan
    field.vtu: 154 points, 130 quad cells
    PyVista: largest displacement 1.14 px
"""

import numpy as np
from numpy.typing import NDArray

import ddic


def stretch(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([0.008 * (points[:, 0] - 150), np.full(len(points), 0.45)])


images = ddic.make_synthetic_pair(stretch, (300, 240), noise=1, seed=8)
mesh = ddic.structured_mesh((20, 20, 280, 220), element_size=20)
result = ddic.measure(images, mesh, regularization={"cut_off_wavelength": 80})

ends = np.array([[47.3, 111.8], [247.3, 111.8]])  # x, y of each point, pixels
length = np.linalg.norm(ends[1] - ends[0])
moved = ends + result.at(ends)
elongation = np.linalg.norm(moved[1] - moved[0]) - length
print(f"gauge length {length:.1f} px, elongation {elongation:.3f} px, strain {elongation / length:.5f}")
print(f"outside the mesh: {result.at(np.array([[5.0, 5.0]]))[0, 0]}")

exported = result.to_meshio()
exported.write("field.vtu")
block = exported.cells[0]
print(f"field.vtu: {len(exported.points)} points, {len(block.data)} {block.type} cells")

grid = result.to_pyvista()  # grid.plot(scalars="displacement") opens a window
print(f"PyVista: largest displacement {np.linalg.norm(grid['displacement'], axis=1).max():.2f} px")

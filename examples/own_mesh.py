"""Measure on a mesh of your own, in millimetres.

A disc of 24 mm, meshed with triangles in millimetres, as a mesh generator would do it, and handed over as a meshio
mesh; meshio.read takes some forty formats. The camera sees 10 pixels per millimetre. The disc grows by 0.4 %, so its
rim moves outwards by 12 mm x 0.004 = 0.048 mm.

    python examples/own_mesh.py

prints

    193 nodes, 336 triangles
    the rim moves outwards by 0.0482 mm
"""

import meshio
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

import ddic

PIXELS_PER_MM = 10
CENTRE_PX: NDArray[np.float64] = np.array([149.5, 149.5])


def growth(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.004 * (points - CENTRE_PX)


reference, deformed = ddic.make_synthetic_pair(growth, (300, 300), noise=1, seed=2)

# Rings of nodes, millimetres from the centre of the disc.
rings = [np.zeros((1, 2))]
for radius in np.linspace(1.7, 12, 7):
    angle = np.linspace(0, 2 * np.pi, round(4 * radius), endpoint=False)
    rings.append(radius * np.column_stack([np.cos(angle), np.sin(angle)]))
nodes = np.concatenate(rings)
mesh = meshio.Mesh(nodes, [("triangle", Delaunay(nodes).simplices)])

# Where the mesh lies in the image: its scale, and the pixel on which its origin falls.
mapping = {"scale": PIXELS_PER_MM, "translation": CENTRE_PX}
result = ddic.measure((reference, deformed), mesh={"file": mesh, "mapping": mapping})
print(f"{result.mesh.n_nodes} nodes, {result.mesh.n_cells} triangles")

on_rim = np.linalg.norm(nodes, axis=1) > 11.9
outwards = nodes[on_rim] / 12
u_mm = result.fields["displacement_mesh_units"][on_rim]
print(f"the rim moves outwards by {(u_mm * outwards).sum(axis=1).mean():.4f} mm")

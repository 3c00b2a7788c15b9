"""How rough a field is: the forces that it leaves out of equilibrium."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.elasticity import Material, assemble_stiffness
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_areas
from ddic.mesh.topology import find_boundary_nodes


def measure_gap(mesh: Mesh, displacement: NDArray[np.float64], material: Material) -> float:
    """Measure the RMS of div s over Young's modulus: K u at interior nodes, each over its share of the area.

    Parameters
    ----------
    mesh : Mesh
        Lengths in pixels.
    displacement : (n_nodes, dim) array
        Pixels; nodes about which one has none do not count.
    material : Material
        The same in all cells.

    Returns
    -------
    float
        1/px, alike for elements of any size; nan where no node counts.
    """
    stiffness = assemble_stiffness(mesh, material)
    forces = (stiffness @ displacement.ravel()).reshape(displacement.shape)
    is_interior = np.ones(mesh.n_nodes, dtype=bool)
    is_interior[find_boundary_nodes(mesh)] = False
    counts = is_interior & np.isfinite(forces).all(axis=1)
    if not counts.any():
        return float("nan")
    n_corners = np.diff(mesh.offsets)
    shares = np.repeat(np.abs(measure_areas(mesh)) / n_corners, n_corners)
    areas = np.bincount(mesh.connectivity, shares, minlength=mesh.n_nodes)
    return float(np.sqrt((forces[counts] ** 2 / areas[counts, None] ** 2).mean()))

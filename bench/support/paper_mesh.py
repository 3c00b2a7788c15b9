"""The unstructured T3/Q4 mesh of the open-hole beam, by Gmsh."""

from __future__ import annotations

from pathlib import Path

Region = tuple[float, float, float, float]
Circle = tuple[tuple[float, float], float]

FRONTAL_DELAUNAY = 6
SIMPLE_RECOMBINATION = 0
"""Joins pairs of triangles where the quadrangle is good and leaves the others: about one cell in five stays a T3."""


def write_gmsh_mesh(path: Path, region: Region, element_size: float, hole: Circle) -> None:
    """Write a mixed mesh of a rectangle with a circular hole; lengths in pixels.

    Raises RuntimeError where Gmsh is not installed.
    """
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise RuntimeError(f"Gmsh is not usable ({error}); install the extra \"bench\" of pyproject.toml "
                           "(make bench-paper does) and the system libraries that it names") from error
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        x0, y0, x1, y1 = region
        (x, y), radius = hole
        shapes = gmsh.model.occ
        beam = shapes.addRectangle(x0, y0, 0, x1 - x0, y1 - y0)
        surface, _ = shapes.cut([(2, beam)], [(2, shapes.addDisk(x, y, 0, radius, radius))])
        shapes.synchronize()
        options = {"Mesh.MeshSizeMin": element_size, "Mesh.MeshSizeMax": element_size,
                   "Mesh.Algorithm": FRONTAL_DELAUNAY, "Mesh.RecombinationAlgorithm": SIMPLE_RECOMBINATION,
                   "Mesh.Binary": 1, "Mesh.MshFileVersion": 4.1}
        for name, value in options.items():
            gmsh.option.setNumber(name, value)
        gmsh.model.mesh.setRecombine(2, surface[0][1])
        gmsh.model.mesh.generate(2)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()

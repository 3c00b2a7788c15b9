"""Meshes that gmsh makes of a region, which follow its outline and its holes; gmsh is installed by itself."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.mesh.cell_type import Q4, T3
from ddic.mesh.holes import Circle, Polygon, RegionLike, convert_holes, convert_region, require_inside
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.repair import repair
from ddic.mesh.structured import refuse_impossible
from ddic.mesh.topology import find_boundary_facets, find_boundary_sets

NAME = "mesh.unstructured"
"""What messages call the mesh."""

ON_OUTLINE = 1e-6
"""Distance, pixels, from a hole's outline below which a node lies on it; gmsh puts them there within rounding."""

CELLS = {"T3": {"Mesh.Algorithm": 6, "Mesh.RecombineAll": 0},
         "Q4": {"Mesh.Algorithm": 8, "Mesh.RecombineAll": 1, "Mesh.RecombinationAlgorithm": 2}}
"""gmsh's options for each type of cell: frontal Delaunay; the same for quadrilaterals, joined, subdivided and smoothed,
which leaves hardly a triangle and flat corners beside holes of the elements' size alone."""

OF_GMSH = {2: T3, 3: Q4}
"""Cell types by gmsh's numbers."""


def build_unstructured_mesh(region: RegionLike, element_size: float, cell: Literal["T3", "Q4"] = "T3",
                            circles: Sequence[tuple[tuple[float, float], float]] = (),
                            polygons: Sequence[Array] = ()) -> Mesh:
    """Mesh a region by triangles or quadrilaterals that follow its outline and its holes; gmsh makes them.

    Parameters
    ----------
    region : (x0, y0, x1, y1), (centre, radius) or (n, 2) array
        A box, a circle, or the vertices of a polygon, each of which becomes a node; pixels.
    element_size : float
        Length of the cells' sides, pixels.
    cell : {"T3", "Q4"}
        Type of the cells.
    circles : sequence of (centre, radius)
        Round holes, pixels.
    polygons : sequence of (n, 2) arrays
        Vertices of other holes, pixels.

    Returns
    -------
    Mesh
        With node sets left, right, top, bottom, by where the outer boundary faces, and hole_0, hole_1, ... (circles,
        then polygons).

    Raises
    ------
    InputError
        Where an argument is impossible, a hole leaves the region, nothing is left of it, or gmsh is not installed.
    """
    outline = convert_region(region, f"{NAME}.region")
    box: Any = region if outline is None else outline.box
    refuse_impossible(box, element_size, cell, NAME)
    if outline is None:
        if len(box) != 4:
            raise InputError(f"{NAME}.region: a plane one, (x0, y0, x1, y1), is meshed; mesh a box of a volume by "
                             "structured_mesh, or read a file of Tet4 or Hex8")
        outline = Polygon.from_box(box)
    holes = convert_holes(circles, polygons, NAME)
    require_inside(holes, outline, element_size / 4, NAME)
    with _started_gmsh() as gmsh:
        for name, value in {"Mesh.MeshSizeMin": element_size, "Mesh.MeshSizeMax": element_size, **CELLS[cell]}.items():
            gmsh.option.setNumber(name, value)
        mesh = _generate(gmsh.model, outline, holes)
    on_holes = [np.flatnonzero(np.abs(hole.measure_distance(mesh.nodes)) < ON_OUTLINE) for hole in holes]
    return replace(mesh, node_sets=find_boundary_sets(mesh.nodes, find_boundary_facets(mesh), on_holes))


@contextmanager
def _started_gmsh() -> Iterator[Any]:
    """Yield gmsh, silent, with nothing in it; it is closed at the end. What it refuses is an InputError."""
    try:
        import gmsh
    # A library of the system that gmsh needs may be missing.
    except (ImportError, OSError) as error:
        raise InputError(f"{NAME}: gmsh makes this mesh and cannot be imported ({error}); install it (pip install "
                         "gmsh, or ddic with its extra: ddic[gmsh]), or use [mesh.structured]") from error
    if gmsh.isInitialized():
        raise InputError(f"{NAME}: gmsh is in use in this process; call gmsh.finalize() first")
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        yield gmsh
    except InputError:
        raise
    # gmsh raises nothing more special.
    except Exception as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{NAME}: gmsh cannot mesh the region ({reason}); simplify its outline, or use smaller "
                         "elements, or cell = \"T3\"") from error
    finally:
        gmsh.finalize()


def _generate(model: Any, outline: Circle | Polygon, holes: Sequence[Circle | Polygon]) -> Mesh:
    """The mesh of a region without holes, its cells running positively."""
    surfaces = [(2, _draw(model.occ, shape)) for shape in (outline, *holes)]
    left = model.occ.cut(surfaces[:1], surfaces[1:])[0] if holes else surfaces
    if not left:
        raise InputError(f"{NAME}: no cell is left; holes cover the whole region")
    model.occ.synchronize()
    model.mesh.generate(2)
    tags, coordinates, _ = model.mesh.getNodes()
    numbers = np.zeros(int(tags.max()) + 1, dtype=np.int64)
    numbers[tags.astype(np.int64)] = np.arange(len(tags))
    kinds, _, nodes_of_kinds = model.mesh.getElements(2)
    blocks = [(OF_GMSH[int(kind)], numbers[nodes.astype(np.int64)].reshape(-1, OF_GMSH[int(kind)].n_nodes))
              for kind, nodes in zip(kinds, nodes_of_kinds, strict=True)]
    return repair(build_mesh(coordinates.reshape(-1, 3)[:, :2], blocks))


def _draw(occ: Any, shape: Circle | Polygon) -> int:
    """Number of the surface inside an outline."""
    if isinstance(shape, Circle):
        (x, y), radius = shape.center, shape.radius
        return int(occ.addDisk(x, y, 0, radius, radius))
    points = [occ.addPoint(x, y, 0) for x, y in shape.vertices.tolist()]
    sides = [occ.addLine(start, end) for start, end in zip(points, points[1:] + points[:1], strict=True)]
    return int(occ.addPlaneSurface([occ.addCurveLoop(sides)]))

"""The displacement of one step of a finite element program's file, on linear cells, in pixels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.errors import InputError, list_first
from ddic.io.input_file import require_file
from ddic.io.mesh_file import convert_mesh
from ddic.io.simulations.formats import Step, open_steps
from ddic.mesh.mesh import Mesh, Similarity
from ddic.mesh.refinement import HALVED
from ddic.mesh.repair import repair

FIELDS = ("displacement", "displacements", "disp", "u", "depl", "displ", "uu")
"""Names, in lower case, that programs give to a displacement on nodes."""

SUFFIXES = (".x", ".y", ".z"), ("_x", "_y", "_z"), ("x", "y", "z"), ("1", "2", "3")
"""What follows the name of a field whose components are fields by themselves."""

LAST = -1
"""Number that stands for the last step."""

MOST_NAMED = 6
"""Steps that a message names."""


@dataclass(frozen=True, eq=False)
class SimulatedField:
    """The displacement of a simulation's nodes in one step, in pixels.

    Attributes
    ----------
    mesh : Mesh
        Its cells, linear, in the reference image's pixels.
    displacement : (n_nodes, dim) array
        Pixels.
    step : Step
        Which it is.
    """

    mesh: Mesh
    displacement: Array
    step: Step


def list_steps(path: Path) -> list[Step]:
    """List the steps of a simulation's file; raises InputError where it cannot be read."""
    with _readable(path):
        return list(open_steps(path).steps)


def read_simulation(path: Path, mapping: Similarity, dim: int, step: int | None = None,
                    time: float | None = None, field: str | None = None) -> SimulatedField:
    """Read the displacement of one step, on linear cells, in pixels.

    Parameters
    ----------
    path : Path
        VTU or another format of meshio, MED, PVD or XDMF with steps, Exodus, CalculiX's .frd, CSV with a header.
    mapping : Similarity
        From the file's units to pixels.
    dim : int
        2 for a plane simulation, whose third coordinate is constant.
    step : int, optional
        Number of the step, -1 for the last one.
    time : float, optional
        Time of the step in its place.
    field : str, optional
        Name of the displacement; found by its name where it is left out.

    Returns
    -------
    SimulatedField
        Quadratic cells are split into linear ones, with the values of their own shape functions at new nodes.

    Raises
    ------
    InputError
        Where the file cannot be read, holds several steps and none is chosen, or lacks the one that is, or the field.
    """
    with _readable(path):
        opened = open_steps(path)
        chosen = _choose_step(path, opened.steps, step, time)
        raw = opened.read(opened.steps.index(chosen))
        values = _find_displacement(path, raw, field, dim)
    points, blocks = np.asarray(raw.points, np.float64), raw.cells or _join_points(raw.points[:, :dim])
    raw.points, raw.cells, values = split_quadratic_cells(points, blocks, values)
    mesh = convert_mesh(raw, str(path), mapping, dim)
    used = np.unique(mesh.connectivity)
    displacement = mapping.scale * values[used] @ mapping.get_axes(dim).T
    if not np.isfinite(displacement).all():
        lost = np.flatnonzero(~np.isfinite(displacement).all(axis=1))
        raise InputError(f"{path}: nodes {list_first(used[lost])} have no displacement in step {chosen.describe()}; "
                         "export it on all nodes")
    try:
        return SimulatedField(repair(mesh), displacement, chosen)
    except InputError as error:
        raise InputError([f"{path}: {problem}" for problem in error.problems]) from error


def _choose_step(path: Path, steps: Sequence[Step], step: int | None, time: float | None) -> Step:
    """Choose a step; none is taken unasked where there are several."""
    listed = "; ".join(of.describe() for of in steps[:MOST_NAMED]) + ("; ..." if len(steps) > MOST_NAMED else "")
    if not steps:
        raise InputError(f"{path}: holds no step with a displacement on nodes; export one")
    if time is not None:
        found = [of for of in steps if of.time is not None and np.isclose(of.time, time, rtol=1e-6, atol=0.0)]
        if len(found) != 1:
            raise InputError(f"{path}: {len(found) or 'no'} steps have the time {time:g}; steps are {listed}")
        return found[0]
    if step == LAST or (step is None and len(steps) == 1):
        return steps[-1]
    if step is None:
        raise InputError(f"{path}: holds {len(steps)} steps ({listed}); choose one by its number, by its time, or the "
                         f"last one by {LAST}")
    found = [of for of in steps if of.number == step]
    if not found:
        raise InputError(f"{path}: holds no step {step}; steps are {listed}")
    return found[0]


def _find_displacement(path: Path, raw: Any, name: str | None, dim: int) -> Array:
    """The displacement of the nodes, (n_points, dim), by its name or by what programs call it."""
    fields = {key: np.asarray(values, np.float64) for key, values in raw.point_data.items()
              if np.ndim(values) <= 2 and np.issubdtype(np.asarray(values).dtype, np.number)}
    known = {**fields, **_join_components(fields, dim)}
    vectors = {key: values for key, values in known.items() if values.ndim == 2 and values.shape[1] >= dim}
    wanted = [key for key in vectors if (key == name if name is not None else key.strip().lower() in FIELDS)]
    if len(wanted) == 1:
        return np.ascontiguousarray(vectors[wanted[0]][:, :dim])
    listed = ", ".join(f'"{key}"' for key in vectors) or "none"
    what = f'a vector "{name}"' if name is not None else "one vector that is called a displacement"
    raise InputError(f"{path}: has not {what} on its nodes; vectors there: {listed}; name the one that is meant")


def _join_components(fields: dict[str, Array], dim: int) -> dict[str, Array]:
    """Vectors whose components are fields by themselves, by what their names have in common."""
    joined = {}
    for suffixes in SUFFIXES:
        for key in fields:
            stem = key[:-len(suffixes[0])]
            names = [f"{stem}{suffix if key[-1].islower() or key[-1].isdigit() else suffix.upper()}"
                     for suffix in suffixes[:dim]]
            if stem and key == names[0] and all(fields.get(name, np.zeros((0, 0))).ndim == 1 for name in names):
                joined[stem] = np.column_stack([fields[name] for name in names])
    return joined


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Say of a file that a reader stumbles over that it cannot be read."""
    require_file(path, "simulation")
    try:
        yield
    except InputError:
        raise
    # Readers of damaged files raise anything.
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: this simulation cannot be read ({reason}); export it again, for instance as "
                         "VTU") from error


LONGEST_SIDE = 3.0
"""Side of a triangle, or tetrahedron, between points of a table, over the median of all, from which on it bridges a
hole. A larger value fills wider holes, a smaller one tears coarse parts of a graded mesh."""

FLATTEST = 1e-6
"""Area over the square of the longest side below which a triangle between points is a line."""


def _join_points(points: Array) -> list[Any]:
    """Join the points of a table by triangles, or tetrahedra, none of them across a hole."""
    from meshio import CellBlock
    from scipy.spatial import Delaunay

    cells = Delaunay(points).simplices.astype(np.int64)
    corners = points[cells]
    longest = np.linalg.norm(corners[:, :, None] - corners[:, None], axis=-1).max(axis=(1, 2))
    # Flat ones along a straight edge are left out, too.
    extent = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / longest ** points.shape[1]
    is_kept = (longest <= LONGEST_SIDE * np.median(longest)) & (extent > FLATTEST)
    return [CellBlock("triangle" if points.shape[1] == 2 else "tetra", cells[is_kept])]


# ------------------------------------------------------------------------------------------------ quadratic cells

MIDDLE_OF_QUADRANGLE = (-0.25,) * 4 + (0.5,) * 4
"""Shape functions of eight nodes, corners then sides, in the middle of a quadrangle."""

FACES_OF_HEXAHEDRON = ((0, 1, 2, 3, 8, 9, 10, 11), (4, 5, 6, 7, 12, 13, 14, 15), (0, 1, 5, 4, 8, 17, 12, 16),
                       (1, 2, 6, 5, 9, 18, 13, 17), (2, 3, 7, 6, 10, 19, 14, 18), (3, 0, 4, 7, 11, 16, 15, 19))
"""Corners and sides of each face of a hexahedron of twenty nodes."""

PARTS: dict[str, tuple[str, tuple[tuple[int, ...], ...]]] = {
    "triangle6": ("triangle", HALVED[5]),
    "quad9": ("quad", HALVED[9]),
    "tetra10": ("tetra", ((0, 4, 6, 7), (4, 1, 5, 8), (6, 5, 2, 9), (7, 8, 9, 3),
                          (4, 5, 6, 8), (6, 5, 9, 8), (6, 9, 7, 8), (6, 7, 4, 8))),
    # Nodes 20 to 25 are in the middle of the faces, in their order above, 26 in that of the cell.
    "hexahedron26": ("hexahedron", (
        (0, 8, 20, 11, 16, 22, 26, 25), (8, 1, 9, 20, 22, 17, 23, 26), (20, 9, 2, 10, 26, 23, 18, 24),
        (11, 20, 10, 3, 25, 26, 24, 19), (16, 22, 26, 25, 4, 12, 21, 15), (22, 17, 23, 26, 12, 5, 13, 21),
        (26, 23, 18, 24, 21, 13, 6, 14), (25, 26, 24, 19, 15, 21, 14, 7))),
}
"""Linear cells that together are a quadratic one, by the nodes of that."""


def split_quadratic_cells(points: Array, blocks: Sequence[Any], values: Array) -> tuple[Array, list[Any], Array]:
    """Split the quadratic cells of a mesh of meshio into linear ones.

    ``points`` are (n, 2 or 3), ``values`` what is known of them, (n, k). Where the middle of a cell or a face has no
    node it gets one, at which the cell's own shape functions put both.
    """
    from meshio import CellBlock

    found = []
    for block in blocks:
        kind, nodes = block.type, np.asarray(block.data, np.int64)
        if kind == "quad8":
            kind = "quad9"
            points, values, middle = _add_nodes(points, values, nodes, MIDDLE_OF_QUADRANGLE)
            nodes = np.column_stack([nodes, middle])
        elif kind == "hexahedron20":
            kind, of_cell = "hexahedron26", nodes
            for face in FACES_OF_HEXAHEDRON:
                points, values, middle = _add_nodes(points, values, of_cell[:, face], MIDDLE_OF_QUADRANGLE)
                nodes = np.column_stack([nodes, middle])
            points, values, middle = _add_nodes(points, values, of_cell, (-0.25,) * 8 + (0.25,) * 12)
            nodes = np.column_stack([nodes, middle])
        if kind in PARTS:
            kind, parts = PARTS[kind]
            nodes = nodes[:, parts].reshape(-1, len(parts[0]))
        found.append(CellBlock(kind, nodes))
    return points, found, values


def _add_nodes(points: Array, values: Array, nodes: IntArray,
               shapes: Sequence[float]) -> tuple[Array, Array, IntArray]:
    """Nodes at which shape functions of cells, (n_cells, n_nodes), put points and values; with their numbers."""
    numbers = len(points) + np.arange(len(nodes))
    new_points, new_values = (np.einsum("a,eai->ei", shapes, of_nodes[nodes]) for of_nodes in (points, values))
    return np.concatenate([points, new_points]), np.concatenate([values, new_values]), numbers

"""Random meshes and partitions for property tests."""

from __future__ import annotations

from typing import Literal

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from ddic.mesh.cell_type import HEX8, Q4, T3, TET4
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.partition.split import renumber, split_by_blocks, split_by_metis

SEEDS = st.integers(0, 2**32 - 1)
Cells = Literal["Q4", "T3", "mixed"]


def grid_mesh(columns: int, rows: int, size: tuple[float, float], *, origin: tuple[float, float] = (0.0, 0.0),
              cells: Cells = "Q4", seed: int = 0, jitter: float = 0.0,
              matrix: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.0), (0.0, 1.0))) -> Mesh:
    """Rows x columns of cells; nodes moved at random by up to ``jitter`` sizes, then mapped linearly.

    With a jitter up to 0.2 the quadrilaterals stay convex. "mixed": half of the quadrilaterals are split.
    """
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(columns + 1.0), np.arange(rows + 1.0))
    nodes = np.column_stack([x.ravel(), y.ravel()])
    nodes = (nodes + rng.uniform(-jitter, jitter, nodes.shape)) * size @ np.array(matrix).T + origin
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    quads = np.column_stack([first, first + 1, first + columns + 2, first + columns + 1])
    split = {"Q4": np.zeros(len(quads), dtype=bool), "T3": np.ones(len(quads), dtype=bool),
             "mixed": rng.random(len(quads)) < 0.5}[cells]
    turned = np.where(rng.random(len(quads))[:, None] < 0.5, quads, np.roll(quads, 1, axis=1))[split]
    blocks = {Q4: quads[~split], T3: turned[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)}
    return build_mesh(nodes, {kind: block for kind, block in blocks.items() if len(block)})


def delaunay_mesh(seed: int, n_points: int, extent: float, step: float | None = None,
                  holes: float = 0.2) -> Mesh:
    """Triangles between random points of a square, a share of them left out.

    step: coordinates are multiples of it, which brings pixel centres onto edges and nodes.
    """
    rng = np.random.default_rng(seed)
    points = rng.uniform(0.0, extent, (n_points, 2))
    if step is not None:
        points = np.unique(np.round(points / step) * step, axis=0)
        if np.linalg.matrix_rank(points - points[0]) < 2:
            # Few points may lie on a line.
            points = np.unique(np.vstack([points, points[0] + [step, 0.0], points[0] + [0.0, step]]), axis=0)
    triangles = Delaunay(points, qhull_options="QJ Pp" if step is None else None).simplices.astype(np.int64)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    triangles[area < 0] = triangles[area < 0][:, ::-1]
    kept = (np.abs(area) > 1e-9 * extent**2) & (rng.random(len(area)) >= holes)
    kept[np.argmax(np.abs(area))] = True
    mesh = build_mesh(points, {T3: triangles[kept]})
    return mesh.create_submesh(np.arange(mesh.n_cells))[0]


@st.composite
def grid_meshes(draw: st.DrawFn, smallest: float = 2.0, largest: float = 14.0, most: int = 5) -> Mesh:
    """Distorted grids of T3 and Q4, at any angle, with coordinates of any kind."""
    size = st.floats(smallest, largest)
    angle, shear = draw(st.floats(-3.2, 3.2)), draw(st.floats(-0.5, 0.5))
    c, s = np.cos(angle), np.sin(angle)
    return grid_mesh(draw(st.integers(1, most)), draw(st.integers(1, most)), (draw(size), draw(size)),
                     origin=(draw(st.floats(-20, 20)), draw(st.floats(-20, 20))),
                     cells=draw(st.sampled_from(["Q4", "T3", "mixed"])), seed=draw(SEEDS),
                     jitter=draw(st.sampled_from([0.0, 0.2])),
                     matrix=((c, c * shear - s), (s, s * shear + c)))


@st.composite
def lattice_meshes(draw: st.DrawFn) -> Mesh:
    """Meshes whose nodes have integer or half-integer coordinates: many pixel centres lie on edges."""
    step = draw(st.sampled_from([0.5, 1.0]))
    if draw(st.booleans()):
        return delaunay_mesh(draw(SEEDS), draw(st.integers(4, 30)), draw(st.sampled_from([6.0, 20.0, 120.0])), step)
    mesh = grid_mesh(draw(st.integers(1, 4)), draw(st.integers(1, 4)), (6.0, 6.0), seed=draw(SEEDS),
                     cells=draw(st.sampled_from(["Q4", "T3", "mixed"])), jitter=draw(st.sampled_from([0.0, 0.16])))
    nodes = np.round(mesh.nodes / step) * step
    return Mesh(nodes, mesh.connectivity, mesh.offsets, mesh.types)


@st.composite
def delaunay_meshes(draw: st.DrawFn) -> Mesh:
    """Triangles of all shapes with holes, coordinates of any kind."""
    return delaunay_mesh(draw(SEEDS), draw(st.integers(4, 40)), draw(st.floats(5, 40)))


def random_partition(mesh: Mesh, kind: str, n_subdomains: int, seed: int) -> NDArray[np.int64]:
    """Subdomain of each cell: "metis", "blocks" or "labels" (at random, so that subdomains fall apart)."""
    n = min(n_subdomains, mesh.n_cells)
    if kind == "metis":
        return split_by_metis(mesh, n)
    if kind == "blocks":
        return split_by_blocks(mesh, (n, 2))
    labels = np.random.default_rng(seed).integers(0, n, mesh.n_cells)
    return renumber(labels)


PARTITIONS = st.sampled_from(["metis", "blocks", "labels"])


WAYS = [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]
"""Of a cube six tetrahedra, one for each way from corner 0 to corner 6 along edges."""


def box_mesh(seed: int, cells: str, n: tuple[int, int, int] = (4, 3, 5), jitter: float = 1.0) -> Mesh:
    """Boxes of 8 x 6 x 9 px whose nodes are moved by up to ``jitter``, or tetrahedra, or some of both."""
    rng = np.random.default_rng(seed)
    sizes = zip((8.0, 6.0, 9.0), n, strict=True)
    grid = GridLines(tuple(-7.3 + size * np.arange(count + 1.0) for size, count in sizes))
    hexes = grid.build_mesh().cells
    is_split = {"Hex8": np.zeros(len(hexes), bool), "Tet4": np.ones(len(hexes), bool),
                "both": rng.random(len(hexes)) < 0.5}[cells]
    # Faces between boxes and tetrahedra stay plane, so that they meet.
    nodes = grid.nodes + rng.uniform(-jitter, jitter, grid.nodes.shape) * (cells != "both")
    blocks = {HEX8: hexes[~is_split], TET4: hexes[is_split][:, WAYS].reshape(-1, 4)}
    return build_mesh(nodes, {kind: block for kind, block in blocks.items() if len(block)})

"""Meshes read from files in any format that meshio knows, and written in those that keep node sets."""

import io
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import redirect_stderr, redirect_stdout
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, IntArray
from ddic.errors import InputError
from ddic.io.input_file import require_file
from ddic.io.replace_on_exit import replaced_on_exit
from ddic.mesh.cell_type import CELL_TYPES, CellType
from ddic.mesh.mesh import Mesh, Similarity, build_mesh

NAMING_CELLS = {"vertex": 0, "line": 1, "triangle": 2, "quad": 2}
"""meshio's names of the cells that, where they are of fewer dimensions than the mesh, only carry the names of node
sets; and their dimension."""

MEASURED = {2: ("triangles", "quadrilaterals", "triangle", "quadrilateral", "plane mesh", "surface"),
            3: ("tetrahedra", "hexahedra", "tetrahedron", "hexahedron", "mesh of these", "volume")}
"""How messages call the cells that are measured, by their dimension, and what holds them."""


NODE_SET = "node set: "
"""Begins the name of a field on the nodes that is 1 in a node set and 0 elsewhere: VTU knows no sets."""

WRITTEN_FORMATS = {".vtu": ("vtu", "<!-- written by ddic mesh -->\n"), ".inp": ("abaqus", "** written by ddic mesh\n")}
"""meshio's formats, by suffix, that are written, which keep every digit and node set; a comment by which files are
known."""


def read_mesh(path: Path, mapping: Similarity, dim: int) -> Mesh:
    """Read a mesh of T3 and Q4, or Tet4 and Hex8 (mixed or not), and map it to pixels; cells keep the file's order.

    Node sets come from the named groups of cells of fewer dimensions (Gmsh physical groups, meshio cell sets), from
    point sets, and from the fields that ``write_mesh`` writes. ``mapping`` leads from the file's units to pixels,
    ``dim`` is 2 for plane cells. The mesh is as it is in the file: not yet repaired. Raises InputError where the file
    cannot be read, holds other cells, or is not plane.
    """
    return convert_mesh(read_raw_mesh(path), str(path), mapping, dim)


def convert_mesh(raw: Any, name: str, mapping: Similarity, dim: int) -> Mesh:
    """Convert a meshio mesh to pixels, as ``read_mesh`` does; ``name`` is what messages call it."""
    measured = {kind.meshio_name: kind for kind in CELL_TYPES.values() if kind.dim == dim}
    blocks = [(measured[b.type], np.asarray(b.data, dtype=np.int64))
              for b in raw.cells if b.type in measured and len(b.data)]
    naming = {kind: n for kind, n in NAMING_CELLS.items() if n < dim}
    _refuse_other_cells(name, raw, set(measured), set(naming), dim)
    points = np.asarray(raw.points, dtype=np.float64)
    if dim == 2:
        points = _plane_points(name, points, blocks)
    return build_mesh(mapping.to_pixels(points), blocks, _node_sets(raw, naming), mapping)


def read_raw_mesh(path: Path) -> Any:
    """The mesh as meshio gives it."""
    import meshio

    require_file(path, "mesh file")
    said = io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said):
            return meshio.read(path)
    # meshio's readers raise anything on a damaged file, and leave by sys.exit on one they do not know.
    except (Exception, SystemExit) as error:
        reason = str(error) if isinstance(error, Exception) and str(error) else said.getvalue()
        text = " ".join(reason.split()) or type(error).__name__
        raise InputError(f"{path}: meshio cannot read this mesh ({text}); convert it, for instance to Gmsh "
                         "4.1 or VTU, or give it the suffix of its format") from error


def _refuse_other_cells(name: str, raw: Any, measured: set[str], naming: set[str], dim: int) -> None:
    """Refuse a file with cells that cannot be measured, or without any that can."""
    found: Counter[str] = Counter()
    for block in raw.cells:
        found[block.type] += len(block.data)
    listed = ", ".join(f"{count} {kind}" for kind, count in found.items()) or "no cells"
    some, others, one, other, what, where = MEASURED[dim]
    if set(+found) - measured - naming:
        raise InputError(f"{name}: only linear {some} and {others} can be used, but the file holds {listed}; export a "
                         f"first-order {what}")
    if not set(+found) & measured:
        raise InputError(f"{name}: holds no {one} and no {other} ({listed}); export the {where} too")


def _plane_points(name: str, points: Array, blocks: list[tuple[CellType, IntArray]]) -> Array:
    """Coordinates x and y; a third one must be the same at all nodes of the cells."""
    used = np.unique(np.concatenate([cells.ravel() for _, cells in blocks]))
    used = used[(used >= 0) & (used < len(points))]
    if points.shape[1] > 2 and len(used):
        spread = np.ptp(points[used], axis=0)
        if spread[2] > 1e-9 * spread[:2].max():
            raise InputError(f"{name}: the mesh is not plane: z varies by {spread[2]:.6g} in mesh units; "
                             "export a mesh of constant z")
    return points[:, :2]


def _node_sets(raw: Any, naming: Mapping[str, int]) -> dict[str, IntArray]:
    """Node sets of all kinds by name, sorted, without empty ones."""
    gathered: dict[str, list[IntArray]] = {}
    for name, nodes in chain(_physical_groups(raw, naming), _cell_sets(raw, naming), raw.point_sets.items(),
                             _marked_nodes(raw)):
        gathered.setdefault(name, []).append(np.asarray(nodes, dtype=np.int64).ravel())
    sets = {name: np.unique(np.concatenate(parts)) for name, parts in gathered.items()}
    return {name: nodes for name, nodes in sets.items() if len(nodes)}


def _physical_groups(raw: Any, naming: Mapping[str, int]) -> Iterator[tuple[str, IntArray]]:
    """Nodes of the naming cells of Gmsh's named physical groups."""
    tags = raw.cell_data.get("gmsh:physical", [])
    for block, of_cells in zip(raw.cells, tags, strict=len(tags) > 0):
        for name, (tag, dimension) in raw.field_data.items():
            if naming.get(block.type) == dimension:
                yield name, np.asarray(block.data)[np.asarray(of_cells) == tag]


def _cell_sets(raw: Any, naming: Mapping[str, int]) -> Iterator[tuple[str, IntArray]]:
    """Nodes of the naming cells of meshio's cell sets."""
    for name, members in raw.cell_sets.items():
        # Gmsh's own bookkeeping, which no user has named.
        if name.startswith("gmsh:"):
            continue
        for block, of_block in zip(raw.cells, members, strict=True):
            if block.type in naming and of_block is not None:
                yield name, np.asarray(block.data)[np.asarray(of_block, dtype=np.int64)]


def _marked_nodes(raw: Any) -> Iterator[tuple[str, IntArray]]:
    """Nodes of the sets that are fields."""
    for name, values in raw.point_data.items():
        if name.startswith(NODE_SET):
            yield name.removeprefix(NODE_SET), np.flatnonzero(values)


def require_written_format(path: Path) -> None:
    """Refuse, by an InputError, a name whose suffix is not that of a format that is written."""
    if path.suffix.lower() not in WRITTEN_FORMATS:
        raise InputError(f"{path}: node sets would be lost; give a name that ends in {' or '.join(WRITTEN_FORMATS)}, "
                         "formats that keep them")


def write_mesh(path: Path, mesh: Mesh) -> None:
    """Write a mesh in pixels, with its node sets, so that ``read_mesh`` reads the same.

    Raises InputError as ``require_written_format`` does, and where the folder cannot be written to.
    """
    require_written_format(path)
    file_format, comment = WRITTEN_FORMATS[path.suffix.lower()]
    refused, other = (",=\n", ".vtu") if file_format == "abaqus" else ('&<"\n', ".inp")
    odd = [name for name in mesh.node_sets if set(name) & set(refused) or name != name.strip()]
    if odd:
        raise InputError(f'{path}: this format cannot name the node set "{odd[0]}"; write a {other} file, or rename it')
    raw = convert_to_meshio(mesh)
    for name, nodes in mesh.node_sets.items():
        if file_format == "abaqus":
            raw.point_sets[name] = nodes
        else:
            raw.point_data[NODE_SET + name] = np.isin(np.arange(mesh.n_nodes), nodes).astype(np.uint8)
    with replaced_on_exit(path) as temporary:
        raw.write(temporary, file_format=file_format)
        with temporary.open("a", encoding="ascii") as stream:
            stream.write(comment)


def convert_to_meshio(mesh: Mesh, point_data: Mapping[str, NDArray[Any]] | None = None,
                      cell_data: Mapping[str, NDArray[Any]] | None = None) -> Any:
    """Convert a mesh to one of meshio, with some fields, whose blocks of cells follow each other as the cells do."""
    import meshio

    starts = [0, *np.flatnonzero(np.diff(mesh.types)) + 1]
    kinds = [CELL_TYPES[int(mesh.types[start])] for start in starts]
    blocks = [(kind.meshio_name, nodes[:, :kind.n_nodes])
              for kind, nodes in zip(kinds, np.split(mesh.cells, starts[1:]), strict=True)]
    points = np.column_stack([mesh.nodes, np.zeros((mesh.n_nodes, 3 - mesh.dim))])
    return meshio.Mesh(points, blocks, dict(point_data or {}),
                       {name: np.split(values, starts[1:]) for name, values in (cell_data or {}).items()})

"""Displacement fields that finite element programs have computed: their files, the steps in them, one step's field.

Each format opens as a list of steps and a function that reads one of them as a mesh of meshio with fields on its nodes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py
import numpy as np

from ddic.arrays import Array, IntArray
from ddic.errors import InputError, list_first
from ddic.io.frd_file import SIDES_BETWEEN_FACES_FIRST, list_frd_steps, read_frd_step
from ddic.io.input_file import require_file
from ddic.io.mesh_file import convert_mesh, read_raw_mesh
from ddic.mesh.mesh import Mesh, Similarity
from ddic.mesh.repair import repair

FIELDS = ("displacement", "displacements", "disp", "u", "depl", "displ", "uu")
"""Names, in lower case, that programs give to a displacement on nodes."""

SUFFIXES = (".x", ".y", ".z"), ("_x", "_y", "_z"), ("x", "y", "z"), ("1", "2", "3")
"""What follows the name of a field whose components are fields by themselves."""

LAST = -1
"""Number that stands for the last step."""

MOST_NAMED = 6
"""Steps that a message names."""


@dataclass(frozen=True)
class Step:
    """A step, increment or frame for which a file holds a displacement.

    Attributes
    ----------
    number : int
        Its place in the file, from 1; in a table what its column says.
    time : float or None
        As the file has it; None where it says none.
    name : str
        What the file calls it, where it is not the time alone.
    """

    number: int
    time: float | None = None
    name: str = ""

    def describe(self) -> str:
        """Say which it is."""
        called = f" ({self.name})" if self.name else ""
        return f"{self.number}{called}" + ("" if self.time is None else f", time {self.time:g}")


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


@dataclass(frozen=True, eq=False)
class _OpenFile:
    """Steps of a file, and what reads the one at a place among them, from 0, as a mesh of meshio."""

    steps: Sequence[Step]
    read: Callable[[int], Any]


def list_steps(path: Path) -> list[Step]:
    """List the steps of a simulation's file; raises InputError where it cannot be read."""
    with _readable(path):
        return list(_open(path).steps)


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
        opened = _open(path)
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


# ------------------------------------------------------------------------------------------------ quadratic cells

MIDDLE_OF_QUADRANGLE = (-0.25,) * 4 + (0.5,) * 4
"""Shape functions of eight nodes, corners then sides, in the middle of a quadrangle."""

FACES_OF_HEXAHEDRON = ((0, 1, 2, 3, 8, 9, 10, 11), (4, 5, 6, 7, 12, 13, 14, 15), (0, 1, 5, 4, 8, 17, 12, 16),
                       (1, 2, 6, 5, 9, 18, 13, 17), (2, 3, 7, 6, 10, 19, 14, 18), (3, 0, 4, 7, 11, 16, 15, 19))
"""Corners and sides of each face of a hexahedron of twenty nodes."""

PARTS: dict[str, tuple[str, tuple[tuple[int, ...], ...]]] = {
    "triangle6": ("triangle", ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))),
    "quad9": ("quad", ((0, 4, 8, 7), (4, 1, 5, 8), (8, 5, 2, 6), (7, 8, 6, 3))),
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


# ------------------------------------------------------------------------------------------------ formats

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


def _open(path: Path) -> _OpenFile:
    return OPENERS.get(path.suffix.lower(), _open_single)(path)


def _open_single(path: Path) -> _OpenFile:
    """A file of one step, in any format that meshio reads."""
    return _OpenFile([Step(1)], lambda _: read_raw_mesh(path))


OF_MED = re.compile(r"(?P<name>.*)\[(?P<place>\d+)\] - (?P<time>.*)")
"""What meshio calls a field of one of several steps in a MED file."""


def _open_med(path: Path) -> _OpenFile:
    """MED, whose steps meshio reads as fields of other names."""
    raw = read_raw_mesh(path)
    fields: dict[tuple[int, float], dict[str, Array]] = {}
    for key, values in raw.point_data.items():
        parts = OF_MED.fullmatch(key)
        if parts is not None:
            place = int(parts["place"]), float(parts["time"])
            fields.setdefault(place, {})[parts["name"].strip()] = values
    if not fields:
        return _OpenFile([Step(1)], lambda _: raw)
    places = sorted(fields)

    def read(number: int) -> Any:
        raw.point_data = fields[places[number]]
        return raw

    return _OpenFile([Step(place + 1, time) for place, time in places], read)


def _open_pvd(path: Path) -> _OpenFile:
    """ParaView's list of files by time."""
    listed = [(float(entry.get("timestep", "nan")), entry.get("file", ""))
              for entry in ElementTree.parse(path).getroot().iter("DataSet")]
    times = [time for time, _ in listed]
    if len(set(times)) < len(times):
        raise InputError(f"{path}: several files have one time (parts of a mesh); export each step as one file")
    steps = [Step(number, None if np.isnan(time) else time) for number, (time, _) in enumerate(listed, start=1)]
    return _OpenFile(steps, lambda place: read_raw_mesh(path.parent / listed[place][1]))


def _open_xdmf(path: Path) -> _OpenFile:
    """XDMF, of one step or of several."""
    from meshio import Mesh as RawMesh
    from meshio.xdmf import TimeSeriesReader

    grids = list(ElementTree.parse(path).getroot().iter("Grid"))
    if not any(grid.get("CollectionType") == "Temporal" for grid in grids):
        return _open_single(path)

    def read(place: int) -> Any:
        with TimeSeriesReader(path) as reader:
            points, cells = reader.read_points_cells()
            _, point_data, _ = reader.read_data(place)
            return RawMesh(points, cells, point_data)

    with TimeSeriesReader(path) as reader:
        reader.read_points_cells()
        steps = [Step(place + 1, reader.read_data(place)[0]) for place in range(reader.num_steps)]
    return _OpenFile(steps, read)


OF_EXODUS = {"tri3": "triangle", "tri": "triangle", "trishell3": "triangle", "tri6": "triangle6", "quad4": "quad",
             "quad": "quad", "shell4": "quad", "shell": "quad", "quad8": "quad8", "quad9": "quad9", "tetra4": "tetra",
             "tet4": "tetra", "tetra": "tetra", "tetra10": "tetra10", "tet10": "tetra10", "hex8": "hexahedron",
             "hex": "hexahedron", "hex20": "hexahedron20"}
"""meshio's names of Exodus's cells."""


def _open_exodus(path: Path) -> _OpenFile:
    """Exodus II, in netCDF's classic format or in HDF5."""
    content = _read_netcdf(path)
    times = content.get("time_whole", np.zeros(0))
    names = ["".join(row.astype("U1")).split("\0")[0].strip() for row in content.get("name_nod_var", [])]

    def read(place: int) -> Any:
        from meshio import Mesh as RawMesh

        axes = [content[f"coord{axis}"] for axis in "xyz" if f"coord{axis}" in content]
        points = np.column_stack(axes) if axes else content["coord"].T
        cells = []
        for key in sorted((key for key in content if re.fullmatch(r"connect\d+", key)), key=lambda key: int(key[7:])):
            kind = OF_EXODUS[content[f"{key} type"].lower()]
            nodes = content[key].astype(np.int64) - 1
            cells.append((kind, nodes[:, SIDES_BETWEEN_FACES_FIRST] if kind == "hexahedron20" else nodes))
        fields = {name: content[f"vals_nod_var{number}"][place] if f"vals_nod_var{number}" in content
                  else content["vals_nod_var"][place, number - 1] for number, name in enumerate(names, start=1)}
        return RawMesh(points, cells, fields)

    return _OpenFile([Step(number, float(time)) for number, time in enumerate(times, start=1)], read)


def _read_netcdf(path: Path) -> dict[str, Any]:
    """All variables by name; of blocks of cells also their type, as "connect1 type"."""
    content: dict[str, Any] = {}
    if h5py.is_hdf5(path):
        with h5py.File(path) as opened:
            for key, values in opened.items():
                content[key] = values[()]
                content |= {f"{key} type": _decode(values.attrs["elem_type"])} if "elem_type" in values.attrs else {}
        return content
    from scipy.io import netcdf_file

    with netcdf_file(path, mmap=False) as opened:
        for key, variable in opened.variables.items():
            # Numbers are big-endian there.
            content[key] = np.array(variable.data, dtype=variable.data.dtype.newbyteorder("="))
            content |= {f"{key} type": _decode(variable.elem_type)} if hasattr(variable, "elem_type") else {}
    return content


def _decode(text: Any) -> str:
    """An attribute of netCDF as text."""
    found = text.decode() if isinstance(text, bytes) else str(text)
    return found.split("\0")[0].strip()


def _open_frd(path: Path) -> _OpenFile:
    """CalculiX's results."""
    steps = list_frd_steps(path)
    return _OpenFile([Step(number, of.time, of.name) for number, of in enumerate(steps, start=1)],
                     lambda place: read_frd_step(path, steps[place]))


def _open_csv(path: Path) -> _OpenFile:
    """A table of points and their displacements: columns x, y (and z), u, v (and w), and perhaps step, or time."""
    from meshio import Mesh as RawMesh

    table: Any = np.genfromtxt(path, delimiter=",", names=True, dtype=np.float64, encoding="utf-8", deletechars="")
    columns = {name.strip().lower(): np.atleast_1d(table[name]) for name in table.dtype.names or ()}
    missing = [name for name in "xyuv" if name not in columns]
    if missing:
        raise InputError(f"{path}: has no column {missing[0]} (columns: {', '.join(columns) or 'none'}); name those of "
                         "the points x, y and of their displacement u, v, with z and w in a volume")
    of_rows = columns.get("step", columns.get("time", np.zeros(len(columns["x"]))))
    found = np.unique(of_rows)

    def read(place: int) -> Any:
        members = of_rows == found[place]
        points, u = (np.column_stack([columns[name][members] for name in names if name in columns])
                     for names in ("xyz", "uvw"))
        return RawMesh(points, [], {"displacement": u})

    if "step" in columns:
        return _OpenFile([Step(int(number)) for number in found], read)
    times = found if "time" in columns else [None]
    return _OpenFile([Step(number, time) for number, time in enumerate(times, start=1)], read)


LONGEST_SIDE = 3.0
"""Side of a triangle, or tetrahedron, between points of a table, over the median of all, from which on it bridges a
hole. A larger value fills wider holes, a smaller one tears coarse parts of a graded mesh."""


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


FLATTEST = 1e-6
"""Area over the square of the longest side below which a triangle between points is a line."""

OPENERS: dict[str, Callable[[Path], _OpenFile]] = {
    ".med": _open_med, ".pvd": _open_pvd, ".xdmf": _open_xdmf, ".xmf": _open_xdmf, ".e": _open_exodus,
    ".exo": _open_exodus, ".ex2": _open_exodus, ".frd": _open_frd, ".csv": _open_csv,
}
"""What opens a file, by its suffix; meshio all others."""

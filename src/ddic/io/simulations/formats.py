"""The formats of simulations' files: each opens as a list of steps and what reads one of them as a mesh of meshio."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py
import numpy as np

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.io.mesh_file import read_raw_mesh
from ddic.io.simulations.frd_file import SIDES_BETWEEN_FACES_FIRST, list_frd_steps, read_frd_step


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
class OpenFile:
    """A simulation's file.

    Attributes
    ----------
    steps : sequence of Step
        For which it holds a displacement.
    read : callable
        Reads the one at a place among them, from 0, as a mesh of meshio.
    """

    steps: Sequence[Step]
    read: Callable[[int], Any]


def open_steps(path: Path) -> OpenFile:
    """Open a simulation's file; whatever reads a damaged one raises anything."""
    return OPENERS.get(path.suffix.lower(), _open_single)(path)


def _open_single(path: Path) -> OpenFile:
    """A file of one step, in any format that meshio reads."""
    return OpenFile([Step(1)], lambda _: read_raw_mesh(path))


OF_MED = re.compile(r"(?P<name>.*)\[(?P<place>\d+)\] - (?P<time>.*)")
"""What meshio calls a field of one of several steps in a MED file."""


def _open_med(path: Path) -> OpenFile:
    """MED, whose steps meshio reads as fields of other names."""
    raw = read_raw_mesh(path)
    fields: dict[tuple[int, float], dict[str, Array]] = {}
    for key, values in raw.point_data.items():
        parts = OF_MED.fullmatch(key)
        if parts is not None:
            place = int(parts["place"]), float(parts["time"])
            fields.setdefault(place, {})[parts["name"].strip()] = values
    if not fields:
        return OpenFile([Step(1)], lambda _: raw)
    places = sorted(fields)

    def read(number: int) -> Any:
        raw.point_data = fields[places[number]]
        return raw

    return OpenFile([Step(place + 1, time) for place, time in places], read)


def _open_pvd(path: Path) -> OpenFile:
    """ParaView's list of files by time."""
    listed = [(float(entry.get("timestep", "nan")), entry.get("file", ""))
              for entry in ElementTree.parse(path).getroot().iter("DataSet")]
    times = [time for time, _ in listed]
    if len(set(times)) < len(times):
        raise InputError(f"{path}: several files have one time (parts of a mesh); export each step as one file")
    steps = [Step(number, None if np.isnan(time) else time) for number, (time, _) in enumerate(listed, start=1)]
    return OpenFile(steps, lambda place: read_raw_mesh(path.parent / listed[place][1]))


def _open_xdmf(path: Path) -> OpenFile:
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
    return OpenFile(steps, read)


OF_EXODUS = {"tri3": "triangle", "tri": "triangle", "trishell3": "triangle", "tri6": "triangle6", "quad4": "quad",
             "quad": "quad", "shell4": "quad", "shell": "quad", "quad8": "quad8", "quad9": "quad9", "tetra4": "tetra",
             "tet4": "tetra", "tetra": "tetra", "tetra10": "tetra10", "tet10": "tetra10", "hex8": "hexahedron",
             "hex": "hexahedron", "hex20": "hexahedron20"}
"""meshio's names of Exodus's cells."""


def _open_exodus(path: Path) -> OpenFile:
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

    return OpenFile([Step(number, float(time)) for number, time in enumerate(times, start=1)], read)


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


def _open_frd(path: Path) -> OpenFile:
    """CalculiX's results."""
    steps = list_frd_steps(path)
    return OpenFile([Step(number, of.time, of.name) for number, of in enumerate(steps, start=1)],
                     lambda place: read_frd_step(path, steps[place]))


def _open_csv(path: Path) -> OpenFile:
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
        return OpenFile([Step(int(number)) for number in found], read)
    times = found if "time" in columns else [None]
    return OpenFile([Step(number, time) for number, time in enumerate(times, start=1)], read)


OPENERS: dict[str, Callable[[Path], OpenFile]] = {
    ".med": _open_med, ".pvd": _open_pvd, ".xdmf": _open_xdmf, ".xmf": _open_xdmf, ".e": _open_exodus,
    ".exo": _open_exodus, ".ex2": _open_exodus, ".frd": _open_frd, ".csv": _open_csv,
}
"""What opens a file, by its suffix; meshio all others."""

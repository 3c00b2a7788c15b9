"""What tells that a result file that can be read is damaged: it does not fit together, or holds something else."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.io import result_schema as schema
from ddic.io.hdf5_file import Arrays
from ddic.mesh.cell_type import CELL_TYPES
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_shape_quality

LARGEST_PX = 1e7
"""Coordinate or displacement beyond which a number is damage: no image is as large."""

_ANY_COMPONENTS = (1, schema.VECTOR, schema.SYMMETRIC_TENSOR)
_COMPONENTS = {field.name: (field.n_components,) for field in schema.list_all_fields()} | {"Points": (schema.VECTOR,)}
"""Numbers that a row of a field may have, by name; of other fields any."""


def require_sound_pieces(grid: Arrays, points: NDArray[Any], point_data: Arrays, cell_data: Arrays) -> None:
    """Refuse pieces of a mesh and their fields that do not fit together, by a ValueError with what does not.

    ``grid`` holds the (n,) arrays of TOPOLOGY, ``points`` are those of all pieces, (n_points, 3); fields are (n,),
    (n, 3) or (n, 6) arrays by name.
    """
    _require_fitting_pieces(grid, len(points))
    _require_sound_cells(grid)
    require_sound_fields({"Points": points, **point_data}, len(points))
    require_sound_fields(cell_data, len(grid["Types"]))
    _require_sound_ids(point_data, cell_data)


def _require_fitting_pieces(grid: Arrays, n_stored: int) -> None:
    """Refuse sizes of pieces that are not those of the arrays; n_stored: points of all pieces."""
    n_points, n_cells, n_ids = (grid[name] for name in schema.PIECES)
    for name, values in grid.items():
        if values.ndim != 1 or values.dtype.kind not in "iu":
            raise ValueError(f"{name}: an array of {values.ndim} dimensions of {values.dtype}")
    if not len(n_points) == len(n_cells) == len(n_ids) or min(map(_least, (n_points, n_cells, n_ids))) < 0:
        raise ValueError("the numbers of points, cells and connectivities are not those of the same pieces")
    wanted = {"Points": (n_stored, n_points.sum()), "Types": (len(grid["Types"]), n_cells.sum()),
              "Offsets": (len(grid["Offsets"]), n_cells.sum() + len(n_cells)),
              "Connectivity": (len(grid["Connectivity"]), n_ids.sum())}
    for name, (found, expected) in wanted.items():
        if found != expected:
            raise ValueError(f"{name}: {found} rows, {expected} expected")
    if not n_cells.sum():
        raise ValueError("no cells")


def _require_sound_cells(grid: Arrays) -> None:
    """Refuse cells with other nodes than their types have, or than their piece has."""
    n_points, n_cells, n_ids = (grid[name] for name in schema.PIECES)
    connectivity, types, offsets = grid["Connectivity"], grid["Types"], grid["Offsets"]
    found = set(np.unique(types).tolist())
    unknown = found - set(CELL_TYPES)
    if unknown:
        raise ValueError(f"Types: no cell is of type {min(unknown)}")
    if len({CELL_TYPES[number].dim for number in found}) > 1:
        raise ValueError("Types: cells in the plane and in space")
    if _least(connectivity) < 0 or (connectivity >= np.repeat(n_points, n_ids)).any():
        raise ValueError("Connectivity: cells have nodes that do not exist")
    n_nodes = np.zeros(1 + max(CELL_TYPES), np.int64)
    for number, cell_type in CELL_TYPES.items():
        n_nodes[number] = len(cell_type.nodes)
    ends = np.cumsum(n_cells + 1) - 1
    counts, first = np.delete(np.diff(offsets, append=0), ends), offsets[ends - n_cells]
    if (counts != n_nodes[types]).any() or first.any() or (offsets[ends] != n_ids).any():
        raise ValueError("Offsets: cells have other numbers of nodes than their types")


def require_sound_fields(fields: Arrays, n_rows: int) -> None:
    """Refuse fields that are not numbers, or have not a row for each place."""
    for name, values in fields.items():
        counts = _COMPONENTS.get(name, _ANY_COMPONENTS)
        shapes = [(n_rows,) if count == 1 else (n_rows, count) for count in counts]
        if values.dtype.kind not in "iuf" or values.shape not in shapes:
            raise ValueError(f"{name}: an array of {values.dtype}, shape {values.shape}; {n_rows} rows of "
                             f"{' or '.join(map(str, counts))} numbers expected")


def _require_sound_ids(point_data: Arrays, cell_data: Arrays) -> None:
    """Refuse numbers of nodes, cells, subdomains and cameras that are none."""
    nodes, cells = point_data[schema.GLOBAL_NODE_ID], cell_data[schema.GLOBAL_CELL_ID]
    for name, numbers in ((schema.GLOBAL_NODE_ID, nodes), (schema.GLOBAL_CELL_ID, cells)):
        if numbers.ndim != 1 or numbers.dtype.kind not in "iu" or _least(numbers) < 0:
            raise ValueError(f"{name}: numbers from 0 on expected")
    for name in (schema.SUBDOMAIN_ID, schema.CAMERA):
        numbers = cell_data.get(name, cells)
        if numbers.dtype.kind not in "iu" or _least(numbers) < 0 or (name in cell_data and numbers.max() >= len(cells)):
            raise ValueError(f"{name}: numbers from 0 on expected, fewer than cells")


def require_sound_values(mesh: Mesh, displacement: Array) -> None:
    """Refuse, by a ValueError, places and displacements, (n_nodes, dim), pixels or nan, that no measurement has."""
    if not (np.abs(mesh.nodes) <= LARGEST_PX).all():
        raise ValueError("Points: nodes lie in no image")
    if (np.abs(displacement) > LARGEST_PX).any():
        raise ValueError("displacement: larger than any image")
    n_shapeless = int((measure_shape_quality(mesh) <= 0.0).sum())
    if n_shapeless:
        raise ValueError(f"Points: {n_shapeless} cells are flat, crossed or not convex")


def _least(values: NDArray[Any]) -> int:
    return int(values.min(initial=0))


_NUMBERS = {
    schema.CASE: (schema.NOISE_FLOOR, "eta", "largest_jump_px", "half_amplitude_shear_px",
                  "half_amplitude_longitudinal_px"),
    schema.UNITS: ("pixel_size",), schema.TIME: ("reference", "deformed"), schema.UNCERTAINTY: ("noise_grey",),
}
"""Attributes that are read as numbers, by group."""

_LENGTHS = ("pixel_size", "half_amplitude_shear_px", "half_amplitude_longitudinal_px")
"""Of these, what others divide by."""

_LONGEST = 1e9
"""Beyond which a length is damage: of a pixel in any unit, or of a wave in pixels."""

_LISTS = ("discontinuity", "near", "region")
"""Sections of a case of which there may be several."""


_COLUMNS = {
    schema.GAUSS_NEWTON: ("iteration", "residual_std_grey"), schema.PHASES: ("phase", "seconds"),
    schema.CORRECTIONS: ("correction", "residual_std_grey", "gain", "noise_gain", "relative_x", "relative_y",
                         "fluctuation_x", "fluctuation_y"),
    schema.OPENING_DEVIATIONS: ("line", "distance_px", "sigma_tangential_px", "sigma_normal_px"),
    schema.COMPARED_REGIONS: ("region", "rms_difference_px", "chi_squared", "scatter"),
    schema.IDENTIFICATION: ("parameter", "value", "deviation", "unit"),
    schema.TIME_MODES: ("frame", "time", "amplitude_1"),
}
"""What others read of a table, by group."""

_TEXTS = ((schema.PHASES, "phase"), (schema.COMPARED_REGIONS, "region"), (schema.IDENTIFICATION, "parameter"),
          (schema.IDENTIFICATION, "unit"))
"""Columns of texts, by group."""

_LARGEST_GREY = 1e100
"""Beyond which a residual is damage: no image has such grey levels."""


def require_sound_tables(tables: Mapping[str, Arrays]) -> None:
    """Refuse tables that lack columns, or whose columns are no numbers or do not have the same rows, by a ValueError.

    ``tables`` holds the (n,) columns by name, of each group; those of the Krylov histories have each its own length.
    """
    for group, columns in tables.items():
        for name, values in columns.items():
            kinds = "OSU" if (group, name) in _TEXTS else "iuf"
            if values.ndim != 1 or values.dtype.kind not in kinds:
                raise ValueError(f"{group}/{name}: an array of {values.dtype}, shape {values.shape}")
            if name.endswith("_grey") and (np.abs(values) > _LARGEST_GREY).any():
                raise ValueError(f"{group}/{name}: larger than any grey level")
        absent = set(_COLUMNS.get(group, ())) - set(columns)
        if columns and absent:
            raise ValueError(f"{group}: no column {min(absent)}")
        if group != schema.KRYLOV and len({len(values) for values in columns.values()}) > 1:
            raise ValueError(f"{group}: columns of different lengths")


def require_sound_frames(times: NDArray[Any], numbers: NDArray[Any], records: Sequence[Any]) -> None:
    """Refuse a series whose frames are not told of as they stand in the file.

    ``times`` and ``numbers`` are (n,), of the frames that were measured; ``records`` are those of all frames. Raises
    ValueError, TypeError or KeyError.
    """
    if numbers.dtype.kind not in "iu":
        raise ValueError(f"{schema.SERIES}.numbers: whole numbers expected")
    if times.ndim != 1 or times.dtype.kind != "f" or times.shape != numbers.shape or not len(times):
        raise ValueError(f"{schema.STEPS}: times of shape {times.shape} for frames of shape {numbers.shape}")
    for record in records:
        _require_number("the time of a frame", record["time"], is_length=False)
        if not record["converged"]:
            str(record["failure"])
    if len({record["number"] for record in records}) < len(records):
        raise ValueError(f"{schema.SERIES}/records: a frame is told of twice")
    told = {record["number"] for record in records if record["converged"]}
    if not set(numbers.tolist()) <= told:
        raise ValueError(f"{schema.SERIES}.numbers: {numbers.tolist()[:3]} and so on, of which not all are told of")


def require_sound_detection(seen: Arrays) -> None:
    """Refuse, by a ValueError or a KeyError, maps of what was seen where lines were looked for that do not fit."""
    n_cells, n_angles, n_distances = (len(np.atleast_1d(seen[name]))
                                      for name in ("tresca_strain", "radon_angles", "radon_distances"))
    wanted = {"centres": (n_cells, 2), "tresca_strain": (n_cells,), "radon_angles": (n_angles,),
              "radon_distances": (n_distances,), "radon_scores": (n_angles, n_distances)}
    for name, shape in wanted.items():
        values = seen[name]
        if values.dtype.kind != "f" or values.shape != shape or not values.size:
            raise ValueError(f"{schema.DETECTION}/{name}: an array of {values.dtype}, shape {values.shape}; numbers of "
                             f"shape {shape} expected")


def require_sound_products(data: Arrays) -> None:
    """Refuse, by a ValueError, PGD-DIC's nodes, functions and amplitudes where they make no displacement."""
    for name, values in data.items():
        if values.dtype.kind != "f" or not (np.abs(values) <= LARGEST_PX).all():
            raise ValueError(f"{schema.SEPARATED}/{name}: numbers no larger than an image expected")
    for axis in "xy":
        nodes = data[f"nodes_{axis}"]
        if nodes.ndim != 1 or len(nodes) < 2 or not (np.diff(nodes) > 0).all():
            raise ValueError(f"{schema.SEPARATED}/nodes_{axis}: ascending numbers expected")
    amplitudes = data["amplitudes"]
    wanted = {"amplitudes": (len(amplitudes), 2) if amplitudes.ndim else (0, 2),
              **{axis: (*amplitudes.shape, len(data[f"nodes_{axis}"])) for axis in "xy"}}
    for name, shape in wanted.items():
        if data[name].shape != shape:
            raise ValueError(f"{schema.SEPARATED}/{name}: an array of shape {data[name].shape}, {shape} expected")


def require_sound_attributes(attributes: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse attributes, by group, that others read as numbers or a case: ValueError, TypeError or KeyError."""
    for group, values in attributes.items():
        if group.startswith(schema.NEAR_PREFIX):
            if "alpha_px" in values and np.asarray(values["alpha_px"], np.float64).shape != (2,):
                raise ValueError(f"{group}.alpha_px: two numbers expected")
            _require_number(f"{group}.theta_rad", values.get("theta_rad", 0.0), is_length=False)
            continue
        for name, value in values.items():
            if np.ndim(value):
                raise ValueError(f"{group}.{name}: {np.ndim(value)} dimensions, one value expected")
    for group, names in _NUMBERS.items():
        for name in names:
            if name in attributes.get(group, {}):
                _require_number(f"{group}.{name}", attributes[group][name], is_length=name in _LENGTHS)
    _require_case(schema.get_case(attributes))


def _require_number(name: str, value: Any, *, is_length: bool) -> None:
    if np.asarray(value).dtype.kind not in "iuf":
        raise ValueError(f"{name}: a number expected")
    if is_length and not 0.0 <= float(value) <= _LONGEST:
        raise ValueError(f"{name}: {value:g} is no length")


def _require_case(case: Any) -> None:
    """Refuse what is no case: sections by name, of keys by name."""
    if not isinstance(case, dict):
        raise TypeError("case.json: sections expected")
    for name, section in case.items():
        inner = section if name in _LISTS and isinstance(section, list) else [section]
        if name != "title" and not all(one is None or isinstance(one, dict) for one in inner):
            raise ValueError(f"case.json: {name} is no section")
    for section in case.get("discontinuity", ()):
        vertices = np.array(section["vertices"], dtype=float)
        if vertices.ndim != 2 or vertices.shape[1] != 2 or len(vertices) < 2 or not np.isfinite(vertices).all():
            raise ValueError("case.json: a discontinuity has no vertices")

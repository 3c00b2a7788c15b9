"""Reads a result file back: one mesh and its fields, y down, whatever the pieces were."""

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import InputError
from ddic.images.window import Window
from ddic.io import damaged_result as damage
from ddic.io import result_schema as schema
from ddic.io.hdf5_file import NONE_KNOWN, READ_ERRORS, Arrays, describe_damage, open_hdf5, read_array
from ddic.io.input_file import FileStamps, as_path, require_file
from ddic.mesh.cell_parts import find_offsets, list_ranges
from ddic.mesh.cell_type import CELL_TYPES
from ddic.mesh.interpolation import EDGE, differentiate_shapes_at, interpolate, locate
from ddic.mesh.mesh import Mesh, pad_cells
from ddic.mesh.plane import build_tree
from ddic.separated.field import LineElements, SeparatedField

SAME_NODE_PX = 1e-9
"""Distance, pixels, from a node below which a point is that node: rounding of coordinates."""


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """A measured field; pixels, y down.

    Attributes
    ----------
    path : Path
        The file.
    mesh : Mesh
        Nodes by global node number, cells by global cell number; pixels.
    displacement : (n_nodes, dim) array
        Pixels.
    point_data, cell_data : dict of (n,), (n, 3) or (n, 6) arrays
        All fields as the file holds them: scalars, vectors, symmetric tensors XX YY ZZ XY YZ XZ.
    subdomain_ids : (n_cells,) array
        Subdomain of each cell.
    gauss_newton : dict of (n_iterations,) arrays
        Columns of the table of iterations.
    krylov : tuple of (n,) array
        Relative residuals of the interface problem, of each iteration of Gauss-Newton.
    attributes : dict of dict
        Of the groups case, provenance, time, units and near_1, near_2, ...
    flipped : bool
        The file itself has y up.
    corrections : dict of (n_corrections,) arrays
        Columns of the table of PGD-DIC's corrections; empty for other methods.
    detection : dict of array
        What was seen where lines were looked for: ``centres`` of cells, (n, 2), pixels, and their ``tresca_strain``,
        (n,); ``radon_scores``, (n_angles, n_distances), by ``radon_angles``, radians, and ``radon_distances``, pixels.
        Empty where none were looked for.
    separated : SeparatedField or None
        The displacement as a sum of products, of which ``displacement`` are values; None for other methods.
    phases : dict of (n_phases,) arrays
        Columns of the table of phases and their times; empty where they were not recorded.
    failure : str
        Why the field is no result: the last one of a measurement that did not converge. Empty where it converged.
    verdict : Verdict or None
        Whether it can be trusted, and why not; None in files before schema 1.8.
    compared_regions : dict of (n,) arrays
        Columns of the table of a comparison with a simulation, a row a region; empty where there is none.
    identified : dict of (n,) arrays
        Columns of the table of a material's parameters; empty where none were sought.
    time_modes : dict of (n_frames,) arrays
        Columns of the table of a series' modes: ``frame``, ``time``, and ``amplitude_1`` ... of each frame, which
        multiply the fields ``time_mode_1`` ...; empty where there are none.
    opening_deviations : dict of (n,) arrays
        Columns of the table of standard deviations of openings along the lines; empty where there are none.
    """

    path: Path
    mesh: Mesh
    displacement: Array
    point_data: Arrays
    cell_data: Arrays
    subdomain_ids: IntArray
    gauss_newton: Arrays
    krylov: tuple[Array, ...]
    attributes: Mapping[str, Mapping[str, Any]]
    flipped: bool
    corrections: Arrays = field(default_factory=dict)
    detection: Arrays = field(default_factory=dict)
    separated: SeparatedField | None = None
    failure: str = ""
    phases: Arrays = field(default_factory=dict)
    verdict: schema.Verdict | None = None
    opening_deviations: Arrays = field(default_factory=dict)
    compared_regions: Arrays = field(default_factory=dict)
    identified: Arrays = field(default_factory=dict)
    time_modes: Arrays = field(default_factory=dict)

    def __repr__(self) -> str:
        origin = "in memory" if self.path == Path() else str(self.path)
        judged = "" if self.verdict is None else f" {self.verdict.word},"
        doubt = judged if self.converged else " NOT CONVERGED,"
        return (f"<ddic.Result {origin}:{doubt} {self.mesh.n_nodes} nodes, {self.mesh.n_cells} cells, "
                f"{self.n_subdomains} subdomains, {len(self.fields)} fields>")

    def _repr_html_(self) -> str:
        """Show a small map in a notebook."""
        drawn: str = import_module("ddic.plots.figures").draw_thumbnail(self)
        return drawn

    @property
    def converged(self) -> bool:
        """Whether the measurement converged; files before schema 1.6 say nothing else."""
        return not self.failure

    @property
    def n_subdomains(self) -> int:
        """Number of subdomains."""
        return len(np.unique(self.subdomain_ids))

    def compute_frame(self, number: int) -> Array:
        """Compute the displacement of a frame of a series from its modes, (n_nodes, dim), pixels.

        ``number`` is from 1. Raises InputError where the result has no modes, or no such frame.
        """
        places = np.flatnonzero(self.time_modes.get("frame", np.zeros(0)) == number)
        if not len(places):
            raise InputError(f"{self.path}: has no modes with a frame {number}; measure a series by ddic modes, and "
                             "count its frames from 1")
        n_modes = sum(name.startswith("amplitude_") for name in self.time_modes)
        return np.asarray(sum(self.time_modes[f"amplitude_{k}"][places[0]] * self.fields[schema.get_mode_name(k)]
                              for k in range(1, n_modes + 1)))

    @property
    def fields(self) -> Arrays:
        """All fields by name, those at the nodes first: (n,) scalars, (n, dim) vectors, (n, 6) symmetric tensors."""
        fields = {**self.point_data, **self.cell_data}
        for name, values in fields.items():
            if values.ndim == 2 and values.shape[1] == schema.VECTOR:
                fields[name] = values[:, :self.mesh.dim]
        return fields

    @property
    def measured_nodes(self) -> BoolArray:
        """Whether each node has a displacement, (n_nodes,): those whose cells all were excluded have nan."""
        return np.asarray(np.isfinite(self.displacement).all(axis=1))

    def at(self, points: Array) -> Array:
        """Interpolate the displacement by the shape functions of the cell that holds a point, or sum its products.

        Parameters
        ----------
        points : (n, dim) array
            Pixels of the reference image.

        Returns
        -------
        (n, dim) array
            Pixels; nan outside the mesh, in its holes and about nodes that were not measured.

        Raises
        ------
        InputError
            Where the points have another shape.
        """
        positions = np.asarray(points, np.float64)
        if positions.ndim != 2 or positions.shape[1] != self.mesh.dim:
            raise InputError(f"points: an array of shape {positions.shape}, (n, {self.mesh.dim}) expected: "
                             f"{' and '.join(schema.AXES[:self.mesh.dim])} of each point, pixels")
        if self.separated is not None:
            return self.separated.at(positions)
        return interpolate(self.mesh, self.displacement, positions)

    def plot(self, kind: str = "displacement", **look: Any) -> Any:
        """Draw a picture, over the reference image if it is still where the measurement found it.

        Parameters
        ----------
        kind : str
            ``displacement``, ``strain``, ``sigma``, ``bias``, ``deformed``, ``residual`` or another ``--kind`` of
            ``ddic plot``.
        **look
            ``component`` of the displacement (x, y, magnitude), ``number`` of the strain (xx, yy, xy, principal-1,
            principal-2, von-mises), ``limits`` of the colours, ``palette`` (matplotlib's name), ``title``. Volumes,
            shown in slices through the middle of the mesh, have z, zz, yz, xz and principal-3 too.

        Returns
        -------
        matplotlib.figure.Figure
            Shown by a notebook; ``savefig`` writes it.

        Raises
        ------
        InputError
            Where the result does not hold what is to be drawn.
        """
        # Looked up when it is called, as plots are drawn of results.
        return import_module("ddic.plots.figures").draw_result(self, kind, **look)

    def view(self) -> Any:
        """Look at the file of this result on a page, which a notebook shows, as ``ddic view`` does.

        Returns
        -------
        NotebookPage
            With its address.

        Raises
        ------
        InputError
            Where ``ddic[page]`` is not installed, or the result is in no file.
        """
        return import_module("ddic.page").view_results(self.path)

    def to_meshio(self) -> Any:
        """Make a meshio mesh with all fields, whose ``write`` knows some forty formats.

        Returns
        -------
        meshio.Mesh
            Pixels, y down; vectors of three components; a block of cells for each cell type, so that cells and their
            data are sorted by type where the mesh mixes them.
        """
        import meshio

        blocks = self.mesh.cell_blocks
        return meshio.Mesh(
            self._points_in_space,
            [(block.type.meshio_name, block.nodes) for block in blocks],
            point_data=dict(self.point_data),
            cell_data={name: [values[block.cells] for block in blocks] for name, values in self.cell_data.items()},
        )

    def to_pyvista(self) -> Any:
        """Make a PyVista grid with all fields, to look at in a notebook.

        Returns
        -------
        pyvista.UnstructuredGrid
            Pixels, y down; vectors of three components; cells in the mesh's order.

        Raises
        ------
        InputError
            Where PyVista is not installed.
        """
        try:
            import pyvista
        except ImportError as error:
            raise InputError("PyVista is not installed here: pip install pyvista") from error
        # VTK's list of cells: the number of a cell's nodes, then its nodes, cell after cell.
        cells = np.insert(self.mesh.connectivity, self.mesh.offsets[:-1], np.diff(self.mesh.offsets))
        grid = pyvista.UnstructuredGrid(cells, self.mesh.types, self._points_in_space)
        grid.point_data.update(self.point_data)
        grid.cell_data.update(self.cell_data)
        return grid

    @property
    def _points_in_space(self) -> Array:
        """Nodes with the coordinates that the mesh does not have set to 0, (n_nodes, 3)."""
        return np.pad(self.mesh.nodes, ((0, 0), (0, 3 - self.mesh.dim)))

    @cached_property
    def residual_image(self) -> NDArray[np.float32] | None:
        """The residual image as the image lies, grey levels, read at first use; None if it was not written."""
        with opened_result(self.path) as (_, file):
            return _read_residual_image(file, self.mesh.dim)

    @cached_property
    def residual_extent(self) -> Window | None:
        """The box of the residual image's pixels; None if it was not written."""
        with self._opened_residual() as stored:
            return None if stored is None else Window.of_size(*stored.shape[::-1])

    def read_residual(self, window: Window) -> NDArray[np.float32]:
        """Read a window inside the residual image, which was written: of a volume what is looked at, grey levels."""
        with self._opened_residual() as stored:
            part = Window.of_size(*stored.shape[::-1]).locate_inside(window)
            return stored[part] if isinstance(stored, np.ndarray) else read_array(stored, part).astype(np.float32)

    @contextmanager
    def _opened_residual(self) -> Iterator[Any]:
        """The residual image, in the file where it was not read yet; None if it was not written."""
        if "residual_image" in self.__dict__:
            yield self.residual_image
        else:
            with opened_result(self.path) as (_, file):
                yield _find_residual_image(file, self.mesh.dim)


def read_result(path: Path | str) -> Result:
    """Read a result file; a UserWarning tells of a field that did not converge.

    Parameters
    ----------
    path : Path or str
        The file.

    Returns
    -------
    Result
        One mesh and its fields, y down.

    Raises
    ------
    InputError
        Where it is missing, foreign, damaged or of a newer major schema.
    """
    with opened_result(path) as (name, file):
        if schema.STEPS in file:
            raise InputError(f"{name}: holds the frames of a series; read it with ddic.open_series, or give the "
                             "result of a pair")
        result = read_open_file(name, file)
    if not result.converged:
        reason = result.failure.partition(";")[0]
        warnings.warn(f"{path}: this field did not converge ({reason})", UserWarning, stacklevel=2)
    return result


def read_independent_fields(path: Path) -> Result:
    """Read the pieces of a result file apart, displaced as each subdomain measured by itself."""
    with opened_result(path) as (name, file):
        apart = read_open_file(name, file, joined=False)
    return replace(apart, displacement=np.ascontiguousarray(apart.point_data[schema.INDEPENDENT][:, :apart.mesh.dim]))


@contextmanager
def opened_result(path: Path | str, known: FileStamps = NONE_KNOWN) -> Iterator[tuple[Path, Any]]:
    """Open a result file, of a pair or of a series, for reading; yield its name and the file.

    Files that are ``known`` are not looked through for damage again.
    Raises InputError where it is missing, foreign, of a newer major schema, or damaged where it is read inside.
    """
    path = as_path(path, "result")
    require_file(path, "result file")
    try:
        with open_hdf5(path, known) as file:
            _check_schema(path, file)
            yield path, file
    except READ_ERRORS as error:
        raise InputError(f"{path}: not a readable ddic result file ({describe_damage(error)}); run ddic again"
                         ) from error


def clip_result(result: Result, low: Array, high: Array) -> Result:
    """Keep the cells of a result that touch the box from ``low`` to ``high``, (dim,) each, pixels, and their nodes.

    What is read inside the box is the same, and sooner. Where no cell touches it, the result is kept whole.
    """
    lowest, highest = result.mesh.outlines.find_boxes()
    touches = ((highest >= low - 2.0 * EDGE) & (lowest <= high + 2.0 * EDGE)).all(axis=1)
    cells = np.flatnonzero(touches)
    return keep_cells(result, cells) if len(cells) else result


def keep_cells(result: Result, cells: IntArray) -> Result:
    """Keep some cells of a result, (n,), and their nodes."""
    mesh, nodes = result.mesh.create_submesh(cells)
    return replace(result, mesh=mesh, displacement=result.displacement[nodes],
                   subdomain_ids=result.subdomain_ids[cells],
                   point_data={name: values[nodes] for name, values in result.point_data.items()},
                   cell_data={name: values[cells] for name, values in result.cell_data.items()})


def displacement_at(result: Result, points: Array) -> Array:
    """Guess the displacement of a result anywhere, to start another run from it; (n, dim), pixels.

    ``Result.at`` is the displacement that was measured; this is a number everywhere, in holes, outside and about nodes
    that were not measured too. It is the nodal value where a measured node lies within 1e-9 px, else what was measured
    there; where nothing was, linear interpolation between the measured nodes (Delaunay), and outside their hull the
    value of the nearest of them. ``points``, (n, dim), are pixels of the reference image.
    """
    from scipy.interpolate import LinearNDInterpolator

    is_measured = result.measured_nodes
    nodes, displacement = result.mesh.nodes[is_measured], result.displacement[is_measured]
    distance, nearest = build_tree(nodes).query(points)
    values: Array = displacement[nearest]
    apart = distance > SAME_NODE_PX
    if apart.any():
        between = result.at(points[apart])
        outside = np.isnan(between).any(axis=1)
        if outside.any():
            between[outside] = LinearNDInterpolator(nodes, displacement)(points[apart][outside])
        values[apart] = np.where(np.isnan(between), values[apart], between)
    return values


def evaluate_on_sides(result: Result, points: Array, beyond: Array) -> Array:
    """Guess the displacement of a result at points beyond a discontinuity, from other points on their own side of it.

    ``points``, (n, 2), lie on the side that is asked for, pixels of the reference image; ``beyond``, (n, 2), is where
    the displacement is wanted, the same points where nothing lies between. What comes back, (n, 2), pixels, is
    ``displacement_at`` the points, and on from there by the slope of the cell that holds them; nan where a node of that
    cell was not measured.
    """
    values = displacement_at(result, points)
    located = locate(result.mesh, points)
    away = np.flatnonzero((points != beyond).any(axis=1) & (located.cells >= 0))
    cells = located.cells[away]
    slopes = differentiate_shapes_at(result.mesh, cells, points[away])
    nodes = pad_cells(result.mesh)[cells]
    gradient = np.einsum("nac,naj->ncj", result.displacement[nodes], slopes[:, :nodes.shape[1]])
    values[away] += np.einsum("ncj,nj->nc", gradient, beyond[away] - points[away])
    return values


def require_known_displacement(result: Result) -> None:
    """Refuse a result to start from that lacks displacements where it measured them.

    Raises InputError where nothing was measured, or a node has no displacement although pixels of its cells count.
    """
    if not result.measured_nodes.any():
        raise InputError(f"{result.path}: holds no displacement of any node; start from another result")
    if schema.get_case(result.attributes).get("discontinuity"):
        # Where a line parts cells, pixels of a node's cells may say nothing of one of its sides.
        return
    n_cells = result.mesh.n_cells
    n_pixels = result.cell_data.get(schema.RESIDUAL_N_PIXELS, np.zeros(n_cells))
    counts = (n_pixels > 0) & (result.cell_data.get(schema.EXCLUDED, np.zeros(n_cells)) == 0)
    nodes = result.mesh.connectivity[np.repeat(counts, np.diff(result.mesh.offsets))]
    n_unknown = len(np.unique(nodes[~result.measured_nodes[nodes]]))
    if n_unknown:
        raise InputError(f"{result.path}: damaged: {n_unknown} nodes of cells that were measured have no displacement; "
                         "run ddic again")


def _check_schema(path: Path, file: Any) -> None:
    """Refuse what is no result, or one that this program would misread, by an InputError with what it is instead."""
    # In messages it takes one line, whatever it is.
    version = " ".join(str(file.attrs.get("ddic_schema", "")).split())
    if not version or schema.VTKHDF not in file:
        raise InputError(f"{path}: an HDF5 file, but not a ddic result; give a file written by ddic run")
    if schema.SHOWS in file.attrs:
        raise InputError(f"{path}: shows {file.attrs[schema.SHOWS]} in its length unit; give that file itself")
    if schema.DISPLACEMENT not in file.get(schema.POINT_DATA, {}):
        raise InputError(f"{path}: holds no displacement (a residual image beside a result?); "
                         "give the result file itself")
    if version.split(".", maxsplit=1)[0] != schema.SCHEMA_VERSION.split(".")[0]:
        raise InputError(f"{path}: schema {version}, this program reads {schema.SCHEMA_VERSION}; "
                         "use the ddic version that wrote it")


def read_open_file(path: Path, file: Any, *, rest: Any = None, pick: Callable[[Any], NDArray[Any]] = read_array,
                   known: Mapping[str, Any] | None = None, joined: bool = True) -> Result:
    """Join the pieces of an open file to a result, or leave each its own copies of the nodes that pieces share.

    ``path`` is what it is called, empty for what is only in memory. A frame of a series is read by ``rest``, the group
    of what is neither its geometry nor its fields, ``pick``, which reads its rows of a dataset of these, and ``known``,
    what is known of its case beside.
    """
    # Only the file of a pair is opened again for its image.
    has_image_at_once = rest is not None or path == Path()
    rest, flipped = file if rest is None else rest, schema.is_flipped(file)
    grid = {name: pick(file[schema.VTKHDF][name]) for name in schema.TOPOLOGY}
    points = pick(file[schema.VTKHDF]["Points"])
    points = schema.flip_components(points) if flipped else points
    point_data, cell_data = (_fields(file[kind], pick, flipped) for kind in (schema.POINT_DATA, schema.CELL_DATA))
    damage.require_sound_pieces(grid, points, point_data, cell_data)
    node_ids = point_data[schema.GLOBAL_NODE_ID] if joined else np.arange(len(points))
    mesh, point_rows, cell_rows = merge_pieces(grid, points, node_ids, cell_data[schema.GLOBAL_CELL_ID])
    at_nodes = {name: values[point_rows] for name, values in point_data.items()}
    on_cells = {name: values[cell_rows] for name, values in cell_data.items()}
    displacement = np.ascontiguousarray(at_nodes[schema.DISPLACEMENT][:, :mesh.dim])
    damage.require_sound_values(mesh, displacement)
    attributes = {name: dict(rest[name].attrs) for name in rest
                  if name in schema.ATTRIBUTE_GROUPS or name.startswith(schema.NEAR_PREFIX)}
    if known:
        attributes[schema.CASE] = {**attributes.get(schema.CASE, {}), **known}
    damage.require_sound_attributes(attributes)
    tables = {group: _arrays(rest, group)
              for group in (schema.GAUSS_NEWTON, schema.KRYLOV, schema.CORRECTIONS, schema.PHASES,
                            schema.OPENING_DEVIATIONS, schema.COMPARED_REGIONS, schema.IDENTIFICATION,
                            schema.TIME_MODES)}
    damage.require_sound_tables(tables)
    result = Result(
        path=path,
        mesh=mesh,
        displacement=displacement,
        point_data=at_nodes,
        cell_data=on_cells,
        subdomain_ids=on_cells[schema.SUBDOMAIN_ID].astype(np.int64),
        gauss_newton=tables[schema.GAUSS_NEWTON],
        krylov=tuple(tables[schema.KRYLOV].values()),
        attributes=attributes,
        flipped=flipped,
        corrections=tables[schema.CORRECTIONS],
        detection=_read_detection(rest),
        separated=_read_separated(rest),
        failure=str(rest.attrs.get(schema.FAILURE, "")),
        phases=tables[schema.PHASES],
        verdict=_read_verdict(rest),
        opening_deviations=tables[schema.OPENING_DEVIATIONS],
        compared_regions=tables[schema.COMPARED_REGIONS],
        identified=tables[schema.IDENTIFICATION],
        time_modes=tables[schema.TIME_MODES],
    )
    if has_image_at_once:
        # What is computed at first use may also be put in place, whatever the class is frozen for.
        result.__dict__["residual_image"] = _read_residual_image(rest, mesh.dim)
    return result


def _read_verdict(file: Any) -> schema.Verdict | None:
    """What was said of the field; None where nothing was."""
    if schema.VERDICT not in file.attrs:
        return None
    return schema.Verdict(str(file.attrs[schema.VERDICT]), tuple(str(file.attrs[schema.REASONS]).splitlines()))


def _read_detection(file: Any) -> Arrays:
    """What was seen where lines were looked for; empty where none were."""
    seen = _arrays(file, schema.DETECTION)
    if seen:
        damage.require_sound_detection(seen)
    return seen


def _read_separated(file: Any) -> SeparatedField | None:
    """The products of an open file; None if there are none."""
    data = _arrays(file, schema.SEPARATED)
    if not data:
        return None
    damage.require_sound_products(data)
    along_x, along_y = LineElements(data["nodes_x"]), LineElements(data["nodes_y"])
    return SeparatedField(along_x, along_y, data["amplitudes"], data["x"], data["y"])


def _read_residual_image(file: Any, dim: int) -> NDArray[np.float32] | None:
    """The first residual image of an open file; None if there is none."""
    stored = _find_residual_image(file, dim)
    return None if stored is None else read_array(stored).astype(np.float32, copy=False)


def _find_residual_image(file: Any, dim: int) -> Any:
    """The dataset of that image."""
    if schema.RESIDUAL_IMAGE not in file:
        return None
    image = file[schema.RESIDUAL_IMAGE][schema.RESIDUAL]
    if image.ndim != dim or image.dtype.kind != "f" or not image.size:
        raise ValueError(f"{schema.RESIDUAL}: an array of {image.dtype}, shape {image.shape}; rows of numbers expected")
    return image


def merge_pieces(grid: Arrays, points: Array, global_node_ids: IntArray,
                 global_cell_ids: IntArray) -> tuple[Mesh, NDArray[np.intp], NDArray[np.intp]]:
    """Merge the pieces of a file to one mesh, nodes and cells in the order of their numbers in the whole mesh.

    ``grid`` is the topology of the file by name; ``points``, (n_points, 3), are those of all pieces with the axes
    wanted, pixels. The ids, (n_points,) and (n_cells,), are numbers of each point's node and of each cell in the whole
    mesh. Beside the mesh come the row of each node among the points, (n_nodes,), and of each cell among the cells,
    (n_cells,).
    """
    # Interface nodes stand in every piece that has them, all copies with the same values but for independent fields.
    first_copy = np.unique(global_node_ids, return_index=True)[1]
    node_ids = np.searchsorted(global_node_ids[first_copy], global_node_ids)
    order = np.argsort(global_cell_ids, kind="stable")
    n_points, n_cells, n_ids = (grid[name] for name in schema.PIECES)
    offsets, connectivity = grid["Offsets"], grid["Connectivity"]
    connectivity = node_ids[connectivity + np.repeat(np.cumsum(n_points) - n_points, n_ids)]
    # Each piece has n_cells + 1 offsets: all but its last are the starts of its cells.
    last = np.cumsum(n_cells + 1) - 1
    starts = np.delete(offsets, last) + np.repeat(np.cumsum(n_ids) - n_ids, n_cells)
    counts = np.delete(np.diff(offsets, append=0), last)
    starts, counts = starts[order], counts[order]
    picked = list_ranges(starts, counts)
    nodes = np.ascontiguousarray(points[first_copy, :get_dim(grid["Types"])])
    mesh = Mesh(nodes, connectivity[picked].astype(np.int64), find_offsets(counts),
                grid["Types"][order].astype(np.uint8))
    return mesh, first_copy, order


def get_dim(types: Any) -> int:
    """Tell whether the mesh of a file lies in the plane or in space, 2 or 3, by the types of its cells."""
    return CELL_TYPES[int(types[0])].dim


def _fields(group: Any, pick: Callable[[Any], NDArray[Any]], flipped: bool) -> dict[str, NDArray[Any]]:
    """All datasets of a group, y down."""
    fields = {}
    for name, data in group.items():
        # Before schema 1.4 all were written as if they had the image's axes.
        axes = str(data.attrs.get("axes", schema.AXES_OF_IMAGE))
        values = pick(data)
        fields[name] = schema.flip_components(values) if flipped and axes == schema.AXES_OF_IMAGE else values
    return fields


def _arrays(file: Any, group: str) -> dict[str, NDArray[Any]]:
    """All datasets of a group; none where there is no such group."""
    if group not in file:
        return {}
    return {name: read_array(data) for name, data in file[group].items()}

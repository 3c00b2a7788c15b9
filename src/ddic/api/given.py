"""What Python programs give in place of files: settings as in a case file, kinematics, ranks, images, mesh, start."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray
from ddic.case.loader import LoadedCase, convert_shorthand, convert_to_case
from ddic.case.named_files import find_frames
from ddic.case.schema import CameraSection, Case, Shape
from ddic.check.case import check_case, load_checked_case
from ddic.errors import InputError, as_collective, refuse_unknown_arguments
from ddic.images.binned import ArraySource
from ddic.images.grey_levels import check_finite, find_saturation
from ddic.images.source import ImageSource
from ddic.images.sub_image import MaskedSource
from ddic.inputs.cameras import open_on_all_ranks
from ddic.inputs.inputs import StartPoints, check_start_points
from ddic.inputs.masks import draw_mask
from ddic.io.input_file import as_path
from ddic.io.mesh_file import convert_mesh
from ddic.io.result_reader import Result
from ddic.io.volume_file import open_mask, read_mask
from ddic.kinematics.kinematics import RegionKinematics
from ddic.mesh.cell_type import CELL_TYPES
from ddic.mesh.mesh import Mesh, Similarity, build_mesh
from ddic.parallel.team import Team
from ddic.start.given_start import GivenStart, keep_displacement

if TYPE_CHECKING:
    import meshio

    MeshLike: TypeAlias = Mesh | meshio.Mesh | tuple[Any, Any]
    """A mesh in memory: ours, one of meshio, or the arrays (nodes, cells)."""

ARGUMENTS = Path("arguments")
"""What messages call what a program gives in place of a case file."""

ChooseKinematics = Callable[[Mesh], RegionKinematics]
"""From the whole mesh, repaired, to its kinematics."""

_IN_MEMORY = "in memory"
"""In place of the name of an image that is given in memory."""


@dataclass(frozen=True, eq=False)
class Arguments:
    """What a program gives beside images: sections of a case, and what is in memory in place of files that they name.

    Attributes
    ----------
    sections : dict
        Without what is in memory.
    reference, deformed : Image, array, str, Path or None
        None where the section of images does not name them.
    mesh : Mesh, meshio.Mesh, tuple of arrays or None
        None where the sections say it.
    start : Result, pair of arrays or None
        A displacement to start from; None where the sections say it.
    output : Path or None
        The result file; None where none is to be written.
    kinematics : callable or None
        From the mesh to its kinematics.
    """

    sections: dict[str, Any]
    reference: Any
    deformed: Any
    mesh: Any
    start: Any
    output: Path | None
    kinematics: ChooseKinematics | None


def sort_arguments(sections: Mapping[str, Any], *, mesh: Any = None, start: Any = None, output: Any = None,
                   kinematics: Any = None, comm: Any = None) -> Arguments:
    """Sort what a program gives, None being nothing; raises InputError where it is of another type, or no section.

    ``mesh``, ``start`` and ``output`` are sections, or what these name by ``file``, ``from_result`` or ``from_points``,
    and ``file``.
    """
    refuse_unknown_arguments(sections, [*Case.model_fields, "kinematics", "comm"])
    if comm is not None and not isinstance(comm, MPI.Comm):
        raise InputError(f"comm: {type(comm).__name__} given; give a communicator of mpi4py")
    if kinematics is not None and not callable(kinematics):
        raise InputError(f"kinematics: {type(kinematics).__name__} given; give a function that makes it of the mesh, "
                         "such as lambda mesh: ddic.LinearRegion(mesh, matrix)")
    kept = {name: section for name, section in sections.items() if section is not None}
    is_result = isinstance(start, Result | str | Path)
    named = (("mesh", "file", mesh), ("start", "from_result" if is_result else "from_points", start),
             ("output", "file", output))
    for name, key, given in named:
        if given is not None:
            kept[name] = given if isinstance(given, Mapping) else {key: given}
    images = {key: _take_out(kept, "volumes" if "volumes" in kept else "images", key)
              for key in ("reference", "deformed")}
    starts = [_take_from_memory(kept, "start", key) for key in ("from_result", "from_points")]
    if None not in starts:
        raise InputError("start.from_result and start.from_points: give one of them")
    file = _take_out(kept, "output", "file")
    return Arguments(kept, images["reference"], images["deformed"], _take_from_memory(kept, "mesh", "file"),
                     next((start for start in starts if start is not None), None),
                     None if file is None else as_path(file, "output"), kinematics)


def _take_out(sections: dict[str, Any], name: str, key: str) -> Any:
    """Take a key out of a section, with the section where nothing is left of it; None where there is no such key.

    That of volumes stays: without it they would be images.
    """
    section = sections.get(name)
    if not isinstance(section, Mapping) or key not in section:
        return None
    rest = {other: value for other, value in section.items() if other != key}
    sections.pop(name)
    if rest or name == "volumes":
        sections[name] = rest
    return section[key]


def _take_from_memory(sections: dict[str, Any], name: str, key: str) -> Any:
    """Take what stands for a file out of a section; None where it names a file, or nothing."""
    section = sections.get(name)
    is_file = isinstance(section, Mapping) and isinstance(section.get(key), str | Path)
    return None if is_file else _take_out(sections, name, key)


def choose_team(comm: MPI.Comm | None) -> Team:
    """Choose the ranks that measure together: those of a communicator, or all."""
    return Team(comm) if isinstance(comm, MPI.Comm) else Team.world()


def check_kinematics(kinematics: ChooseKinematics | None) -> ChooseKinematics | None:
    """Make a function that calls the user's and refuses what it returns, where that is no kinematics of the mesh."""
    if kinematics is None:
        return None

    def choose(mesh: Mesh) -> RegionKinematics:
        found = kinematics(mesh)
        if not isinstance(found, RegionKinematics):
            raise InputError(f"kinematics: the function returned {type(found).__name__}; return a "
                             "ddic.RegionKinematics, such as ddic.LinearRegion")
        # One made beforehand will do, where repairing has changed nothing.
        same = np.array_equal(found.mesh.nodes, mesh.nodes) and np.array_equal(found.mesh.cells, mesh.cells)
        if not same:
            raise InputError("kinematics: made of another mesh; make it of the one that the function is given, whose "
                             "nodes may be numbered anew")
        return found

    return choose


def load_given_case(source: object, place: Path, n_ranks: int, output: Path | None = None) -> LoadedCase:
    """Load a case file, or take a case that is in memory, and check it all; ``place`` stands for the latter's file.

    ``output`` takes the place of the result file that the case names. Raises InputError with a line for each problem.
    """
    if not isinstance(source, Case | LoadedCase):
        return load_checked_case(as_path(source, "case"), n_ranks, output)
    loaded = LoadedCase(source, place, "") if isinstance(source, Case) else source
    if output is not None:
        loaded = loaded.with_output(output)
    check_case(loaded, n_ranks)
    return loaded


def make_case(sections: Mapping[str, Any], reference: Any = None) -> Case:
    """Make a case of sections; images and mesh are in memory where they name none.

    ``reference`` is the image, or volume, that was given; None for images. Raises InputError with a line for each
    unknown key, wrong type and impossible value.
    """
    try:
        data: dict[str, Any] = convert_shorthand(json.loads(json.dumps(dict(sections), default=_plain)))
    except TypeError as error:
        raise InputError(f"{ARGUMENTS}: {error}") from error
    if "near" in data:
        raise InputError(f"{ARGUMENTS}: near fields need a case; measure a case file, or prepare one and measure its "
                         "frames")
    pixels = reference.pixels if isinstance(reference, Image) else reference
    shape: tuple[int, ...] = getattr(pixels, "shape", ())
    # Three or four numbers along the last axis are those of a colour.
    is_volume = "volumes" in data or (len(shape) == 3 and shape[-1] > 4)
    imaging = "volumes" if is_volume else "images"
    if is_volume and "images" in data:
        raise InputError(f"{ARGUMENTS}: images does not go with volumes; give volumes, with voxel_size for pixel_size")
    return find_frames(convert_to_case(_complete(data, imaging), str(ARGUMENTS)), ARGUMENTS)


def is_mesh_named(sections: Mapping[str, Any]) -> bool:
    """Tell whether sections say the mesh, which is in memory else."""
    section = sections.get("mesh")
    return isinstance(section, Mapping) and bool({"file", "structured", "unstructured"} & set(section))


def _complete(data: Mapping[str, Any], imaging: str) -> dict[str, Any]:
    """Sections with names in place of the files that a case must name."""
    images, mesh = data.get(imaging, {}), data.get("mesh", {})
    return {
        **data,
        imaging: {"reference": _IN_MEMORY, "deformed": _IN_MEMORY, **images} if isinstance(images, dict) else images,
        "mesh": mesh if is_mesh_named(data) or not isinstance(mesh, dict) else {"file": "mesh", **mesh},
    }


def _plain(value: object) -> object:
    """Stand in for what JSON does not know: numpy's numbers and arrays, paths, other mappings."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"a value of type {type(value).__name__}; give numbers, texts, lists and mappings")


@dataclass(frozen=True, eq=False)
class Image:
    """A grey-level image with what is left out of it, in place of what a case says of masks and saturation.

    Attributes
    ----------
    pixels : (height, width) array, str or Path
        Grey levels of any integer or float type, or the file that holds them. What a masked array of numpy masks is
        left out.
    mask : (height, width) array, str or Path, optional
        Zero, or False, where pixels are left out; none is by default.
    exclude_saturated : bool
        Leave out saturated pixels; of a reference image, those of its deformed images as well.
    saturation : float, optional
        Grey level from which on a pixel is saturated; found from the image where left out, as in a case file.
    """

    pixels: NDArray[Any] | str | Path
    mask: NDArray[Any] | str | Path | None = None
    exclude_saturated: bool = False
    saturation: float | None = None


ImageLike = Image | NDArray[Any] | str | Path
"""An image, its grey levels (height, width), or its file."""


def make_image(given: ImageLike, section: CameraSection, mask: Path | None) -> Image:
    """Make an image with what the case says of its camera's pixels, and its mask; a ``ddic.Image`` says both itself."""
    return given if isinstance(given, Image) else Image(given, mask, section.exclude_saturated, section.saturation)


def open_given_image(team: Team, given: ImageLike, name: str, shapes: Sequence[Shape] = (), *, dim: int = 2,
                     keeps: bool = False) -> MaskedSource:
    """Open an image that the user gave, the same on all ranks; collective.

    ``name`` is what messages call it, ``shapes`` are those of ``images.masked``, ``dim`` is 3 of a volume. One that
    ``keeps`` is read after the call that it was given to: an array, which the user may write into, is copied. Raises
    InputError on all ranks, where it is no image, its mask is not as large, or a shape is none.
    """
    image = given if isinstance(given, Image) else Image(given)
    pixels = image.pixels
    if isinstance(pixels, str | Path):
        source = open_on_all_ranks(team, dim)(Path(pixels))
        return team.together(lambda: _leave_pixels_out(image, source, name, shapes))
    in_memory = team.together(lambda: _hold_array(pixels, name, dim, keeps=keeps))
    masked = team.together(lambda: _leave_pixels_out(image, in_memory, name, shapes))
    _refuse_other_pixels(team, in_memory, name)
    return masked


def _refuse_other_pixels(team: Team, image: ArraySource, name: str) -> None:
    """Refuse an array that is not the same on all ranks, each of which would correlate its own; collective."""
    checksums = set(team.gather_lists([(image.values.shape, zlib.crc32(image.values.data))]))
    if len(checksums) > 1:
        raise as_collective(InputError(f"{name}: the ranks were given different arrays; give all ranks the same image, "
                                       "or its file"))


def _hold_array(pixels: Any, name: str, dim: int, *, keeps: bool) -> ArraySource:
    values = _convert_to_pixels(pixels, name)
    if values.ndim != dim:
        expected = "(height, width)" if dim == 2 else "(depth, height, width)"
        raise InputError(f"{name}: an array of shape {values.shape}, {expected} expected; convert colours to grey "
                         "levels first")
    if values.size == 0:
        raise InputError(f"{name}: an array of shape {values.shape} holds no pixel")
    is_integer = np.issubdtype(values.dtype, np.integer)
    if not (is_integer or np.issubdtype(values.dtype, np.floating)):
        raise InputError(f"{name}: an array of {values.dtype}, grey levels of an integer or float type expected")
    # Files bring the other byte order at times, which compiled kernels do not read.
    convert = np.array if keeps else np.asarray
    native = convert(values, dtype=values.dtype.newbyteorder("="), order="C")
    saturation = float(np.iinfo(native.dtype).max) if is_integer else None
    return ArraySource(Path(name), native, saturation)


def _leave_pixels_out(image: Image, source: ImageSource, name: str, shapes: Sequence[Shape]) -> MaskedSource:
    if isinstance(image.mask, str | Path) and not isinstance(image.pixels, np.ma.MaskedArray):
        given: ImageSource | None = open_mask(Path(image.mask), source.extent)
    else:
        used = _used_pixels(image, source, name)
        given = None if used is None else ArraySource(Path(f"{name}'s mask"), used.astype(np.uint8))
    mask = draw_mask(shapes, source.extent, "images.masked", given)
    check_finite(source, mask)
    return MaskedSource(source, mask, _find_saturation(image, source, name))


def _find_saturation(image: Image, source: ImageSource, name: str) -> float | None:
    """Grey level from which on pixels are left out; None where none are."""
    if not image.exclude_saturated:
        if image.saturation is not None:
            raise InputError(f"{name}: saturation = {image.saturation:g} goes with exclude_saturated=True")
        return None
    return find_saturation(source) if image.saturation is None else image.saturation


def _used_pixels(image: Image, source: ImageSource, name: str) -> BoolArray | None:
    """Where pixels are used, (height, width); None where all are."""
    used = None if image.mask is None else _read_given_mask(image.mask, source, name)
    if isinstance(image.pixels, np.ma.MaskedArray):
        not_masked = ~np.asarray(np.ma.getmaskarray(image.pixels))  # type: ignore[no-untyped-call]  # numpy 1.26
        used = not_masked if used is None else used & not_masked
    return used


def _read_given_mask(mask: NDArray[Any] | str | Path, image: ImageSource, name: str) -> BoolArray:
    if isinstance(mask, str | Path):
        return read_mask(Path(mask), image.extent)
    values = _convert_to_pixels(mask, f"{name}'s mask")
    if values.shape != image.extent.shape:
        raise InputError(f"{name}: its mask has shape {values.shape}, the image {image.extent.shape}; give one value "
                         "for each pixel")
    return np.asarray(values != 0)


def _convert_to_pixels(given: Any, name: str) -> NDArray[Any]:
    """Convert what was given; numpy refuses ragged lists, and makes arrays of objects of what it does not know."""
    try:
        values = np.asarray(given)
    except ValueError as error:
        raise InputError(f"{name}: rows of different lengths, an array (height, width) expected") from error
    if values.dtype == object:
        raise InputError(f"{name}: no array of grey levels, but {values.dtype.name}s; give an array (height, width), a "
                         "file or ddic.Image")
    return values


_EXPECTED = "give one of ddic.structured_mesh or meshio, the arrays (nodes, cells), or a mesh file"


def convert_given_mesh(given: MeshLike, mapping: Similarity, dim: int) -> Mesh:
    """Convert a mesh that the user gave to one in pixels, not yet repaired; ``mapping`` is from its units to these.

    Raises InputError where it is no plane mesh of triangles and quadrilaterals, or, where ``dim`` is 3, none of
    tetrahedra and hexahedra.
    """
    if isinstance(given, tuple):
        if len(given) != 2:
            raise InputError(f"mesh: a tuple of {len(given)}, two arrays expected; {_EXPECTED}")
        given = _from_arrays(*given, dim)
    if isinstance(given, Mesh):
        if given.dim != dim:
            raise InputError(f"mesh: of {given.dim} dimensions, {dim} expected beside the images; give files of "
                             "volumes as volumes={\"reference\": ..., \"deformed\": ...}")
        if mapping == Similarity():
            # The nodes stay to the last digit.
            return given
        return replace(given, nodes=np.ascontiguousarray(mapping.to_pixels(given.nodes)), mapping=mapping)
    if _is_meshio_like(given):
        return convert_mesh(given, "mesh", mapping, dim)
    raise InputError(f"mesh: {type(given).__name__} is no mesh; {_EXPECTED}")


def _is_meshio_like(given: Any) -> bool:
    """Whether it has points and blocks of cells; PyVista's cells are one array of numbers."""
    if not (hasattr(given, "points") and hasattr(given, "cells") and hasattr(given, "cell_sets")):
        return False
    return all(hasattr(block, "type") and hasattr(block, "data") for block in given.cells)


def _from_arrays(given_nodes: Any, given_cells: Any, dim: int) -> Mesh:
    by_n_nodes = {kind.n_nodes: kind for kind in CELL_TYPES.values() if kind.dim == dim}
    widths = " or ".join(str(n) for n in sorted(by_n_nodes))
    nodes, cells = _convert_rows(given_nodes, "nodes"), _convert_rows(given_cells, "cells")
    if nodes.ndim != 2 or nodes.shape[1] != dim or nodes.dtype.kind not in "iuf":
        raise InputError(f"mesh: nodes of shape {nodes.shape} and type {nodes.dtype}, numbers of shape (n_nodes, "
                         f"{dim}) expected: column and row of each, pixels")
    if cells.ndim != 2 or cells.shape[1] not in by_n_nodes or cells.dtype.kind not in "iu":
        raise InputError(f"mesh: cells of shape {cells.shape} and type {cells.dtype}, whole numbers of shape (n_cells, "
                         f"{widths}) expected: the nodes of each cell, numbered from 0")
    return build_mesh(nodes.astype(np.float64), [(by_n_nodes[cells.shape[1]], cells.astype(np.int64))])


def _convert_rows(given: Any, name: str) -> NDArray[Any]:
    try:
        return np.asarray(given)
    except ValueError as error:
        # Rows of different lengths.
        raise InputError(f"mesh: {name} in rows of different lengths; give a mesh of triangles and quadrilaterals "
                         "together as one of meshio") from error


StartLike = Result | tuple[Any, Any]
"""A result, or points (n, 2) and their displacement (n, 2)."""


def convert_start(team: Team, given: StartLike | None, reference: MaskedSource) -> GivenStart | None:
    """Convert a displacement that the user gave, pixels of the far reference image; None where none is; collective.

    Raises InputError on all ranks, where one of them has something else, or nothing.
    """
    converted = team.together(lambda: None if given is None else _convert_start(given, reference))
    if team.sum(int(given is not None)) not in (0, team.size):
        raise InputError("start: given on some of the ranks; under mpirun give it on every rank")
    return converted


def _convert_start(given: Any, reference: MaskedSource) -> GivenStart:
    if isinstance(given, Result):
        return keep_displacement(given, "the given result" if given.path == Path() else str(given.path))
    if not isinstance(given, tuple | list) or len(given) != 2:
        raise InputError(f"start: {type(given).__name__} given; give a result, or a pair (points, displacement) of "
                         "arrays (n, 2), pixels of the reference image")
    dim = len(reference.extent.sizes)
    points, displacement = _convert_numbers(given[0], "points", dim), _convert_numbers(given[1], "displacement", dim)
    if points.shape != displacement.shape:
        raise InputError(f"start: {len(points)} points and {len(displacement)} displacements; give one of each point")
    converted = StartPoints(points, displacement, "start")
    check_start_points(converted, reference.image.extent)
    return converted


def _convert_numbers(given: Any, what: str, dim: int) -> Array:
    try:
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"start: {what}: {error}; give an array (n, 2) of numbers, pixels") from error
    if array.ndim != 2 or array.shape[1] != dim or not len(array):
        raise InputError(f"start: {what}: an array of shape {array.shape}, (n, {dim}) expected: x and y of each "
                         "point, pixels")
    return array

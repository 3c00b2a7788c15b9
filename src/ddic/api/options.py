"""How to measure: settings as a case file has them, own kinematics, the ranks.

Images given as files or as arrays.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.case.loader import convert_shorthand, convert_to_case
from ddic.case.schema import Case
from ddic.errors import InputError, as_collective
from ddic.images.binned import ArraySource
from ddic.images.grey_levels import check_finite, find_saturation
from ddic.images.source import ImageSource
from ddic.images.sub_image import MaskedSource
from ddic.inputs.cameras import open_on_all_ranks
from ddic.io.image_file import read_mask
from ddic.kinematics.kinematics import RegionKinematics
from ddic.mesh.mesh import Mesh
from ddic.parallel.team import Team

ChooseKinematics = Callable[[Mesh], RegionKinematics]
"""From the whole mesh, repaired, to its kinematics."""

_NO_PATH = "in memory"
_IN_MEMORY = {
    "images": ("pixel_size", "length_unit", "reference_time", "deformed_time", "noise", "at_rest"),
    "mesh": ("mapping",),
    "output": ("residual_image", "flip_y", "uncertainty"),
}
"""Keys that settings may hold of the sections for which arguments stand."""


@dataclass(frozen=True, eq=False)
class Options:
    """How to measure.

    Attributes
    ----------
    settings : mapping
        Sections and keys of a case file, such as ``{"regularization": {"cut_off_wavelength": 60}}``.
    kinematics : callable, optional
        From the mesh to its kinematics; by default the unknowns are the displacements of the nodes.
    comm : mpi4py.MPI.Comm, optional
        The ranks that measure together; by default all that were started.
    """

    settings: Mapping[str, Any] = field(default_factory=dict)
    kinematics: ChooseKinematics | None = None
    comm: MPI.Comm | None = None


def choose_options(options: Options | Mapping[str, Any] | None) -> Options:
    """Look at the options that the user gave.

    Parameters
    ----------
    options : Options, mapping or None
        What the user gave.

    Returns
    -------
    Options
        The same, or the mapping as settings.

    Raises
    ------
    InputError
        Where they are of another type.
    """
    chosen = options if isinstance(options, Options) else Options({} if options is None else options)
    if not isinstance(chosen.settings, Mapping):
        raise InputError(f"options: {type(chosen.settings).__name__} given; give sections and keys of a case file, "
                         'such as {"regularization": {"cut_off_wavelength": 60}}, or ddic.Options')
    if chosen.comm is not None and not isinstance(chosen.comm, MPI.Comm):
        raise InputError(f"options: comm is of type {type(chosen.comm).__name__}; give a communicator of mpi4py")
    if chosen.kinematics is not None and not callable(chosen.kinematics):
        raise InputError(f"options: kinematics is of type {type(chosen.kinematics).__name__}; give a function that "
                         "makes it of the mesh, such as lambda mesh: ddic.LinearRegion(mesh, matrix)")
    return chosen


def choose_team(options: Options | Mapping[str, Any] | None) -> Team:
    """Give the ranks that measure together.

    Parameters
    ----------
    options : Options, mapping or None
        What the user gave; options name the ranks, or not.

    Returns
    -------
    Team
        All ranks by default.
    """
    if isinstance(options, Options) and isinstance(options.comm, MPI.Comm):
        return Team(options.comm)
    return Team.world()


def check_kinematics(kinematics: ChooseKinematics | None) -> ChooseKinematics | None:
    """Give a function that calls the user's and looks at its result.

    Parameters
    ----------
    kinematics : callable or None
        From the mesh to its kinematics.

    Returns
    -------
    callable or None
        The same; it raises InputError where the user's function returns something else.
    """
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


def make_case(settings: Mapping[str, Any]) -> Case:
    """Make a case of settings; what else a case file holds is in memory.

    Parameters
    ----------
    settings : mapping
        Sections and keys of a case file.

    Returns
    -------
    Case
        Validated.

    Raises
    ------
    InputError
        With a line for each unknown key, wrong type and impossible value.
    """
    try:
        data: dict[str, Any] = convert_shorthand(json.loads(json.dumps(dict(settings), default=_plain)))
    except TypeError as error:
        raise InputError(f"options: {error}") from error
    _refuse_what_arguments_say(data)
    return convert_to_case(_complete(data), "options")


def _refuse_what_arguments_say(data: Mapping[str, Any]) -> None:
    for name, keys in _IN_MEMORY.items():
        given = data.get(name)
        # Elements of a pixel are too many for a mesh in memory.
        known = (*keys, "structured") if name == "mesh" and "pgd" in data else keys
        # Of another type it is a mistake that the schema tells.
        unknown = [key for key in given if key not in known] if isinstance(given, dict) else []
        if unknown:
            listed = ", ".join(f"{name}.{key}" for key in known)
            raise InputError(f"options: {name}.{unknown[0]} is for case files; give what it says as an argument. Valid "
                             f"here: {listed}")
    if "near" in data:
        raise InputError("options: near fields need a case; measure a case file, or prepare one and measure its frames")


def _complete(data: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with names in place of the files that a case must name."""
    images, mesh = data.get("images", {}), data.get("mesh", {})
    return {
        **data,
        "images": {"reference": _NO_PATH, "deformed": _NO_PATH, **images} if isinstance(images, dict) else images,
        "mesh": {"file": "mesh", **mesh} if isinstance(mesh, dict) and "structured" not in mesh else mesh,
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
    """A grey-level image with what is left out of it.

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


def open_given_image(team: Team, given: ImageLike, name: str, *, keeps: bool = False) -> MaskedSource:
    """Open an image that the user gave; collective.

    Parameters
    ----------
    team : Team
        All ranks, which give the same image.
    given : ImageLike
        What the user gave.
    name : str
        What messages call it.
    keeps : bool
        Whether it is read after the call that it was given to: an array, which the user may write into, is copied.

    Returns
    -------
    MaskedSource
        Read window by window.

    Raises
    ------
    InputError
        On all ranks, where it is no image, or its mask is not as large.
    """
    image = given if isinstance(given, Image) else Image(given)
    pixels = image.pixels
    if isinstance(pixels, str | Path):
        source = open_on_all_ranks(team)(Path(pixels))
        return team.together(lambda: _leave_pixels_out(image, source, name))
    in_memory = team.together(lambda: _hold_array(pixels, name, keeps=keeps))
    masked = team.together(lambda: _leave_pixels_out(image, in_memory, name))
    _refuse_other_pixels(team, in_memory, name)
    return masked


def _refuse_other_pixels(team: Team, image: ArraySource, name: str) -> None:
    """Refuse an array that is not the same on all ranks, each of which would correlate its own; collective."""
    checksums = set(team.gather_lists([(image.values.shape, zlib.crc32(image.values.tobytes()))]))
    if len(checksums) > 1:
        raise as_collective(InputError(f"{name}: the ranks were given different arrays; give all ranks the same image, "
                                       "or its file"))


def check_same_size(image: MaskedSource, reference: MaskedSource, name: str) -> None:
    """Check that a deformed image is as large as its reference image.

    Parameters
    ----------
    image, reference : MaskedSource
        The images.
    name : str
        What messages call the deformed one.

    Raises
    ------
    InputError
        Where it is not.
    """
    found, wanted = image.extent, reference.extent
    if found != wanted:
        raise InputError(f"{name}: {found.width} x {found.height} px, but the reference image has {wanted.width} x "
                         f"{wanted.height} px; give images of one size")


def _hold_array(pixels: Any, name: str, *, keeps: bool) -> ArraySource:
    values = _as_array(lambda: np.asarray(pixels), name)
    if values.ndim != 2:
        raise InputError(f"{name}: an array of shape {values.shape}, (height, width) expected; convert colours to grey "
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


def _leave_pixels_out(image: Image, source: ImageSource, name: str) -> MaskedSource:
    used = _used_pixels(image, source, name)
    check_finite(source, used)
    mask = None if used is None else ArraySource(Path(f"{name}'s mask"), used.astype(np.uint8))
    return MaskedSource(source, mask, _find_saturation(image, source, name))


def _find_saturation(image: Image, source: ImageSource, name: str) -> float | None:
    """Grey level from which on pixels are left out; None where none are."""
    if not image.exclude_saturated:
        if image.saturation is not None:
            raise InputError(f"{name}: saturation = {image.saturation:g} goes with exclude_saturated=True")
        return None
    return find_saturation(source) if image.saturation is None else image.saturation


def _used_pixels(image: Image, source: ImageSource, name: str) -> NDArray[np.bool_] | None:
    """Where pixels are used, (height, width); None where all are."""
    used = None if image.mask is None else _read_given_mask(image.mask, source, name)
    if isinstance(image.pixels, np.ma.MaskedArray):
        not_masked = ~np.asarray(np.ma.getmaskarray(image.pixels))  # type: ignore[no-untyped-call]  # numpy 1.26
        used = not_masked if used is None else used & not_masked
    return used


def _read_given_mask(mask: NDArray[Any] | str | Path, image: ImageSource, name: str) -> NDArray[np.bool_]:
    if isinstance(mask, str | Path):
        return read_mask(Path(mask), image.width, image.height)
    values = _as_array(lambda: np.asarray(mask), f"{name}'s mask")
    if values.shape != (image.height, image.width):
        raise InputError(f"{name}: its mask has shape {values.shape}, the image ({image.height}, {image.width}); "
                         "give one value for each pixel")
    return np.asarray(values != 0)


def _as_array(convert: Callable[[], NDArray[Any]], name: str) -> NDArray[Any]:
    """Convert what was given; numpy refuses ragged lists, and makes arrays of objects of what it does not know."""
    try:
        values = convert()
    except ValueError as error:
        raise InputError(f"{name}: rows of different lengths, an array (height, width) expected") from error
    if values.dtype == object:
        raise InputError(f"{name}: no array of grey levels, but {values.dtype.name}s; give an array (height, width), a "
                         "file or ddic.Image")
    return values

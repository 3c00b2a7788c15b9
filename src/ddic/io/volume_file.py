"""Volumes on disk as sources of boxes: raw numbers, TIFF, folders of slices, .npy, HDF5, Zarr, and what ITK reads.

A box is read from what lies under it alone: nobody holds a volume, but of a file that can only be decoded whole. What
opens masks, and images and volumes alike, is here as well.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from functools import cached_property, partial
from importlib import import_module
from itertools import groupby
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import DTypeLike, NDArray

from ddic.arrays import BoolArray
from ddic.errors import InputError
from ddic.images.binned import ArraySource
from ddic.images.source import ImageSource, SizedImage
from ddic.images.window import Window
from ddic.io import image_formats as formats
from ddic.io import input_file
from ddic.io.hdf5_file import READ_ERRORS
from ddic.io.image_file import ImageFile, open_decoded, open_slices
from ddic.io.text_files import parse_toml, read_text

TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")
"""Of raw numbers."""

OF_ITK = (".dcm", ".gz", ".ima", ".map", ".mha", ".mhd", ".mrc", ".nhdr", ".nii", ".nrrd", ".rec")
"""Endings of files that ITK reads."""

POSITION = "0020|0032"
"""Where a DICOM slice lies, as ITK calls it."""

MOST_LISTED = 5
"""Arrays of a file that a message lists."""

_ERRORS = (*READ_ERRORS, *formats.DECODING_ERRORS)
"""What libraries raise on files that are damaged, or hold what they do not know."""

Reader = Callable[[Window], NDArray[Any]]
"""Reads a box of a volume, an array of its shape in any byte order; it goes to other ranks."""


@dataclass(frozen=True)
class VolumeFile(SizedImage):
    """A volume on disk, read box by box; nothing stays open or in memory between reads.

    Attributes
    ----------
    path : Path
        What the case names.
    sizes : tuple of int
        Voxels along x, y and z.
    dtype : dtype
        Type of the grey levels that ``read`` returns.
    reader : callable
        Reads a box.
    is_compressed : bool
        Voxels are decoded as they are read, so that only reading shows whether they can be.
    is_whole : bool
        Any box takes decoding all of them.
    """

    path: Path
    sizes: tuple[int, ...]
    dtype: np.dtype[Any]
    reader: Reader
    is_compressed: bool = False
    is_whole: bool = False

    @cached_property
    def extent(self) -> Window:
        """The box of all its voxels."""
        return Window.of_size(*self.sizes)

    @property
    def saturation(self) -> float | None:
        """Largest grey level that the integer type holds, None for a float volume."""
        return None if self.dtype.kind == "f" else float(np.iinfo(self.dtype).max)

    def read(self, window: Window) -> NDArray[Any]:
        """Read grey levels of a box, an array of its shape and of type ``dtype``.

        Raises ValueError if the box leaves the volume or is empty, InputError if it cannot be read.
        """
        self.extent.locate_inside(window)
        try:
            return np.ascontiguousarray(self.reader(window), dtype=self.dtype)
        except _ERRORS as error:
            raise InputError(f"{self.path}: cannot be read, damaged or cut short ({_shorten(error)}); copy or save it "
                             "again") from error


@dataclass(frozen=True)
class Planes:
    """Numbers that lie in files as they are, row after row in each plane.

    Attributes
    ----------
    files : tuple of Path
        One that holds all planes, or one for each.
    offsets : sequence of int
        First byte of each plane.
    stored : dtype
        Type of the numbers, in the files' byte order.
    width : int
        Numbers a row.
    """

    files: Sequence[Path]
    offsets: Sequence[int]
    stored: np.dtype[Any]
    width: int

    def __call__(self, box: Window) -> NDArray[Any]:
        """Read a box; raises ValueError where a file has become too short."""
        (x0, y0, z0), (x1, y1, z1) = box.lower, box.upper
        out = np.empty(box.shape, self.stored)
        # Whole rows, less what lies beside the first and the last: one read a plane takes less than one a row. Files
        # are not mapped, for one that is cut short meanwhile would end the process.
        content = bytearray((y1 - y0) * self.width * self.stored.itemsize)
        rows = np.frombuffer(content, self.stored).reshape(y1 - y0, self.width)
        wanted = memoryview(content)[:len(content) - (self.width - x1 + x0) * self.stored.itemsize]
        for file, planes in groupby(range(z0, z1), lambda z: self.files[z % len(self.files)]):
            with file.open("rb") as stream:
                for z in planes:
                    stream.seek(self.offsets[z] + (y0 * self.width + x0) * self.stored.itemsize)
                    if stream.readinto(wanted) < len(wanted):
                        raise ValueError("the file has become shorter")
                    out[z - z0] = rows[:, :x1 - x0]
        return out


def is_volume(path: Path) -> bool:
    """Tell whether a path leads to a volume and no image, as far as its beginning shows, or a stack of TIFF pages."""
    try:
        file, _ = input_file.split_dataset(path)
        return _choose_opener(file) is not _open_tiff or formats.read_tiff_format(file, dim=3).n_pages > 1
    except (InputError, *_ERRORS):
        return False


def open_source(path: Path, dim: int) -> tuple[ImageFile | VolumeFile, NDArray[Any] | None]:
    """Open an image, or where ``dim`` is 3 a volume, and keep what had to be decoded for that.

    That is all grey levels where the file can only be decoded whole, else None. Raises InputError if it is missing,
    damaged, or nothing that can be read.
    """
    return open_decoded(path) if dim == 2 else _open_volume(Path(path))


def hold_source(path: Path, dim: int) -> ImageSource:
    """Open an image or a volume as ``open_source`` does; one that can only be decoded whole is held in memory."""
    source, pixels = open_source(path, dim)
    return source if pixels is None else ArraySource(source.path, pixels, source.saturation)


def read_mask(path: Path, extent: Window) -> BoolArray:
    """Read a mask, an array of the extent's shape: True where the image is not 0, which are the pixels to use.

    ``extent`` is the box of the image, or volume, that it belongs to. Raises InputError where the mask cannot be read
    or has another size.
    """
    source = open_mask(path, extent)
    return np.asarray(source.read(source.extent) != 0)


def open_mask(path: Path, extent: Window) -> ImageSource:
    """Open a mask, to be read box by box; raises InputError as ``read_mask`` does."""
    source = hold_source(path, len(extent.sizes))
    if source.extent != extent:
        raise InputError(f"{path}: the mask is {source.extent.describe()} px, but its image is {extent.describe()} px; "
                         "give a mask of the image's size")
    return source


def _open_volume(path: Path) -> tuple[VolumeFile, NDArray[Any] | None]:
    """A volume, of which the last voxel at least was read, and all of its voxels where it is decoded whole."""
    file, name = input_file.split_dataset(path)
    if not os.path.isdir(file):
        input_file.require_file(file, "volume")
    try:
        opener = _choose_opener(file)
        if name and opener is not _open_array:
            raise InputError(f"{path}: only in HDF5 and Zarr are there arrays with names; give {file}")
        volume = opener(path)
    except _ERRORS as error:
        raise InputError(f"{path}: no volume that can be read, or damaged ({_shorten(error)})") from error
    formats.check_claimed_size(path, *volume.sizes)
    if volume.is_whole:
        formats.check_decoded_size(path, *volume.sizes)
        return volume, volume.read(volume.extent)
    volume.read(Window(tuple(size - 1 for size in volume.sizes), volume.sizes))
    return volume, None


def _shorten(error: BaseException) -> str:
    """The last line of a library's message, which says most."""
    return (str(error).strip().splitlines() or [type(error).__name__])[-1]


def _choose_opener(file: Path) -> Callable[[Path], VolumeFile]:
    """What opens a volume, by what the file is."""
    if os.path.isdir(file):
        return _open_array if input_file.is_zarr(file) else _open_folder
    sidecar = input_file.find_sidecar(file)
    with file.open("rb") as stream:
        is_npy = stream.read(6) == np.lib.format.MAGIC_PREFIX
    openers = ((_open_raw, sidecar.is_file()), (_open_npy, is_npy), (_open_tiff, formats.is_tiff(file)),
               (_open_array, h5py.is_hdf5(file)), (_open_by_itk, file.suffix.lower() in OF_ITK))
    for opener, is_it in openers:
        if is_it:
            return opener
    raise InputError(f"{file}: no volume; give a TIFF file of many pages, the folder of its slices, .npy, HDF5, Zarr, "
                     f"or beside raw numbers a file {sidecar.name} that says shape = [x, y, z] and type = \"uint16\"")


def _take_type(path: Path, stored: DTypeLike) -> np.dtype[Any]:
    """Type in memory of numbers that are stored so."""
    dtype = np.dtype(stored)
    if dtype.kind not in "buif" or dtype.itemsize > 8:
        raise InputError(f"{path}: values of type {dtype}; grey levels are integers or floats of 64 bits at most")
    return np.dtype(np.uint8) if dtype.kind == "b" else dtype.newbyteorder("=")


def _lay_planes(path: Path, stored: np.dtype[Any], sizes: tuple[int, ...], offset: int) -> VolumeFile:
    """A volume of numbers that follow each other to the end of a file."""
    dtype, plane, size = _take_type(path, stored), sizes[0] * sizes[1] * stored.itemsize, path.stat().st_size
    if min(sizes) < 1 or size != offset + sizes[2] * plane:
        raise InputError(f"{path}: {' x '.join(map(str, sizes))} voxels of {stored.name} after {offset} bytes make a "
                         f"file of {offset + sizes[2] * plane} bytes, but it has {size}; copy it again, or correct "
                         "what is said of it")
    return VolumeFile(path, sizes, dtype, Planes([path], range(offset, size, plane), stored, sizes[0]))


def _open_raw(path: Path) -> VolumeFile:
    sidecar = input_file.find_sidecar(path)
    said = {"byte_order": "little", "offset": 0, **parse_toml(read_text(sidecar, "sidecar", "check it"), sidecar)}
    shape, offset = said.get("shape"), said["offset"]
    is_right = {
        "shape = [x, y, z], numbers of voxels":
            isinstance(shape, list) and len(shape) == 3 and all(type(n) is int and n > 0 for n in shape),
        f"type = one of {', '.join(TYPES)}": said.get("type") in TYPES,
        'byte_order = "little" or "big"': said["byte_order"] in ("little", "big"),
        "offset = a number of bytes": type(offset) is int and offset >= 0,
        "shape, type, byte_order and offset alone": set(said) <= {"shape", "type", "byte_order", "offset"},
    }
    if not all(is_right.values()):
        raise InputError([f"{sidecar}: {expected} expected" for expected, is_it in is_right.items() if not is_it])
    stored = np.dtype(said["type"]).newbyteorder("<" if said["byte_order"] == "little" else ">")
    return _lay_planes(path, stored, tuple(said["shape"]), offset)


def _open_npy(path: Path) -> VolumeFile:
    # Mapped, but for its header not looked at.
    voxels = np.load(path, mmap_mode="r")
    if voxels.ndim != 3 or not voxels.flags.c_contiguous:
        order = "" if voxels.flags.c_contiguous else " in Fortran's order"
        raise InputError(f"{path}: an array of shape {voxels.shape}{order}, (z, y, x) in C's order expected; save "
                         "numpy.ascontiguousarray of such a one")
    return _lay_planes(path, voxels.dtype, voxels.shape[::-1], voxels.offset)


def _open_tiff(path: Path) -> VolumeFile:
    if not formats.can_decode(path):
        raise InputError(f"{path}: no codec is installed for the compression of this TIFF; save it uncompressed, or "
                         "install imagecodecs")
    layout = formats.read_tiff_format(path, dim=3)
    if layout.n_channels > 1 or layout.n_colours > 1:
        raise InputError(f"{path}: pages of colours; save grey levels")
    if layout.n_pages == 1:
        raise InputError(f"{path}: one page, or a stack cut short; give a file of many pages, or the folder of "
                         "its slices")
    reader: Reader = partial(formats.read_tiff, path, layout)
    if layout.stored is not None:
        reader = Planes([path], layout.offsets, layout.stored, layout.width)
    return VolumeFile(path, (layout.width, layout.height, layout.n_pages), layout.dtype, reader, layout.is_compressed)


def _open_folder(path: Path) -> VolumeFile:
    files = input_file.list_parts(path)
    endings = {file.suffix.lower().replace(".tiff", ".tif") for file in files}
    if len(endings) != 1:
        raise InputError(f"{path}: a folder of {', '.join(sorted(endings)) or 'no'} files; give one of the slices of "
                         "one volume alone")
    if not endings <= {*input_file.SLICES}:
        return _open_by_itk(path)
    _require_no_gap(files)
    slices = open_slices(files)
    layouts = [each.layout for each in slices]
    if layouts[0].n_channels > 1 or layouts[0].n_colours > 1 or layouts[0].n_pages > 1:
        raise InputError(f"{files[0]}: several pages or colours; give slices of one page of grey levels")
    reader: Reader = partial(_read_slices, slices)
    if layouts[0].stored is not None and len({layout.stored for layout in layouts}) == 1:
        reader = Planes(files, [layout.offsets[0] for layout in layouts], layouts[0].stored, layouts[0].width)
    return VolumeFile(path, (layouts[0].width, layouts[0].height, len(files)), slices[0].dtype, reader,
                      is_compressed=not isinstance(reader, Planes))


def _require_no_gap(files: Sequence[Path]) -> None:
    """Refuse slices of which one is missing: the last numbers in their names do not grow by equal steps."""
    numbers = [[number for is_number, number, _ in input_file.split_numbers(Path(file.stem)) if is_number]
               for file in files]
    steps = np.diff([found[-1] for found in numbers]) if all(numbers) else np.zeros(0)
    for k in np.flatnonzero(steps != steps[:1])[:1]:
        raise InputError(f"{files[k]}: {files[k + 1].name} follows, by another step than before: a slice is missing, "
                         "or one of another volume is there")


def _read_slices(slices: Sequence[ImageFile], box: Window) -> NDArray[Any]:
    plane = Window(box.lower[:2], box.upper[:2])
    return np.stack([each.read(plane) for each in slices[box.lower[2]:box.upper[2]]])


def _opened(path: Path, file: Path) -> Any:
    """An HDF5 file or a Zarr folder, in a ``with`` statement."""
    if file.is_dir():
        return nullcontext(_import("zarr", "zarr", path).open(str(file), mode="r"))
    with suppress(ImportError):
        # Further compressions, where they are installed.
        import_module("hdf5plugin")
    return h5py.File(file, "r")


def _open_array(path: Path) -> VolumeFile:
    file, name = input_file.split_dataset(path)
    with _opened(path, file) as opened:
        if name and name not in opened:
            raise InputError(f"{path}: there is no {name} in {file.name}; it holds {', '.join(opened) or 'nothing'}")
        found = _choose_array(path, opened[name] if name else opened, name)
        array = opened[found] if found else opened
        sides = _find_sides(opened.attrs, array.attrs, found)
        if np.size(sides) == 3:
            formats.check_cubes(path, np.ravel(sides)[::-1].tolist())
        return VolumeFile(path, tuple(array.shape[:-4:-1]), _take_type(path, array.dtype),
                          partial(_read_array, path, found), is_compressed=array.chunks is not None)


def _choose_array(path: Path, within: Any, name: str) -> str:
    """Name in the file of an array, or of the only one of axes z, y and x in a group and the groups in it."""
    items: list[tuple[str, Any]] = [("", within)] if hasattr(within, "shape") else []
    if isinstance(within, h5py.Group):
        within.visititems(lambda key, item: items.append((key, item)))
    elif not items:
        items = within.members(max_depth=None)
    shapes = {f"{name}/{key}".strip("/"): item.shape or () for key, item in items if hasattr(item, "shape")}
    # Microscopes have axes of one channel and one time before these.
    volumes = [key for key, shape in shapes.items() if len(shape) >= 3 and max(shape[:-3], default=1) == 1]
    if len(volumes) != 1:
        some = [f"{key} {shape}" for key, shape in shapes.items() if key in volumes or not volumes]
        listed = ", ".join(some[:MOST_LISTED]) + ", ..." * (len(some) > MOST_LISTED)
        remedy = f"name one: FILE{input_file.DATASET}{volumes[0]}" if volumes else "give another file"
        raise InputError(f"{path}: {len(volumes)} arrays of axes z, y, x ({listed or 'no array'}); {remedy}")
    return volumes[0]


def _find_sides(said: Mapping[str, Any], of_array: Mapping[str, Any], name: str) -> Any:
    """Sides (z, y, x) of a voxel, as OME's Zarr folders and Fiji's HDF5 files say them; None where none are said."""
    for scales in said.get("ome", said).get("multiscales", ()):
        for array in scales["datasets"]:
            for transformation in array.get("coordinateTransformations", ()) if array["path"] == name else ():
                if "scale" in transformation:
                    return transformation["scale"][-3:]
    return of_array.get("element_size_um")


def _read_array(path: Path, name: str, box: Window) -> NDArray[Any]:
    with _opened(path, input_file.split_dataset(path)[0]) as opened:
        array = opened[name] if name else opened
        return np.asarray(array[(*[0] * (len(array.shape) - 3), *map(slice, box.lower[::-1], box.upper[::-1]))])


def _import(name: str, extra: str, path: Path) -> Any:
    """A package of an extra; InputError, one line, where it is not installed."""
    try:
        return import_module(name)
    except ImportError as error:
        raise InputError(f"{path}: {name} is needed to read it: pip install 'ddic[{extra}]'") from error


def _open_by_itk(path: Path) -> VolumeFile:
    """A file of a format that ITK knows, or a folder of DICOM slices."""
    itk, files = _import("SimpleITK", "itk", path), [path]
    itk.ProcessObject.SetGlobalWarningDisplay(False)
    if path.is_dir():
        series = itk.ImageSeriesReader.GetGDCMSeriesIDs(str(path))
        if len(series) != 1:
            raise InputError(f"{path}: {len(series)} series of DICOM files; give a folder of one, or of images")
        # In the order of their positions.
        files = [Path(file) for file in itk.ImageSeriesReader.GetGDCMSeriesFileNames(str(path), series[0])]
        if len(files) == 1:
            raise InputError(f"{path}: one slice; give the folder of all of them")
    headers = [_read_header(itk, file) for file in files]
    sizes, spacing = headers[0].GetSize(), headers[0].GetSpacing()
    types = {getattr(itk, f"sitk{name.title().replace('Uint', 'UInt')}"): np.dtype(name) for name in TYPES}
    dtype = types.get(headers[0].GetPixelID())
    if dtype is None or len(sizes) != 3 or len({(header.GetSize(), header.GetPixelID()) for header in headers}) > 1:
        raise InputError(f"{path}: {' x '.join(map(str, sizes))} values, "
                         f"{itk.GetPixelIDValueAsString(headers[0].GetPixelID())}, or slices of several sizes and "
                         "types; grey levels of one volume expected")
    if path.is_dir():
        sizes = (*sizes[:2], len(files))
        places = [[float(x) for x in header.GetMetaData(POSITION).split("\\")] for header in headers]
        steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
        formats.check_cubes(path, [*spacing[:2], steps.min()])
        formats.check_cubes(path, [*spacing[:2], steps.max()])
    else:
        formats.check_cubes(path, spacing)
    # What is shorter than its voxels is compressed, and of NRRD ITK never reads a box alone.
    n_bytes = sum(part.stat().st_size for part in input_file.list_parts(path))
    is_whole = path.is_file() and (n_bytes < prod(sizes) * dtype.itemsize or path.suffix.lower() in (".nrrd", ".nhdr"))
    return VolumeFile(path, sizes, dtype, partial(_read_by_itk, files), is_compressed=True, is_whole=is_whole)


def _read_header(itk: Any, file: Path) -> Any:
    header = itk.ImageFileReader()
    header.SetFileName(str(file))
    header.ReadImageInformation()
    return header


def _read_by_itk(files: Sequence[Path], box: Window) -> NDArray[Any]:
    """A box of a file, or of one file a slice."""
    itk, planes, parts = import_module("SimpleITK"), slice(box.lower[2], box.upper[2]), []
    for file in files[planes] if len(files) > 1 else files:
        reader = _read_header(itk, file)
        if len(files) == 1:
            reader.SetExtractIndex(box.lower)
            reader.SetExtractSize(box.sizes)
        with formats.caught_messages():
            part = itk.GetArrayFromImage(reader.Execute())
        parts.append(part if len(files) == 1 else part[:, box.lower[1]:box.upper[1], box.lower[0]:box.upper[0]])
    return np.concatenate(parts)

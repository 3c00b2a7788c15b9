"""Volumes on disk: each format written by another library or by hand, and read back by boxes; what is refused."""

from __future__ import annotations

import json
import os
import pickle
import struct
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.binned import ArraySource
from ddic.images.source import ImageSource
from ddic.images.volume import read_coefficients, read_values
from ddic.images.window import Window
from ddic.io import image_formats, volume_file
from ddic.io.input_file import FileStamps, list_parts, split_dataset
from ddic.io.volume_file import Planes, VolumeFile, hold_source, is_volume, open_mask, open_source, read_mask

SHAPE = (7, 11, 13)
"""Planes, rows, columns."""


def voxels(dtype: str = "uint16") -> NDArray[Any]:
    rng = np.random.default_rng(1)
    if np.dtype(dtype).kind == "f":
        return rng.normal(0, 1e3, SHAPE).astype(dtype)
    limits = np.iinfo(dtype)
    return rng.integers(limits.min, limits.max, SHAPE, dtype=dtype, endpoint=True)


def write_raw(path: Path, array: NDArray[Any], order: str = "little", offset: int = 0, **said: Any) -> Path:
    stored = array.astype(array.dtype.newbyteorder("<" if order == "little" else ">"))
    path.write_bytes(b"\7" * offset + stored.tobytes())
    keys = {"shape": list(array.shape[::-1]), "type": array.dtype.name, "byte_order": order, "offset": offset, **said}
    path.with_name(f"{path.name}.toml").write_text(
        "".join(f"{key} = {json.dumps(value)}\n" for key, value in keys.items() if value is not None))
    return path


def write_slices(folder: Path, array: NDArray[Any], ending: str = ".tif", **keywords: Any) -> Path:
    folder.mkdir()
    (folder / ".hidden").write_text("of the desktop")
    (folder / "scan.log").write_text("of the scanner")
    for number, plane in enumerate(array, start=5):
        # No leading zeros: 10 comes after 9.
        file = folder / f"slice_{number}{ending}"
        if ending == ".tif":
            tifffile.imwrite(file, plane, **keywords)
        else:
            cv2.imwrite(str(file), plane)
    return folder


def write_large_imagej(path: Path, array: NDArray[Any]) -> Path:
    """As ImageJ beyond 4 GiB: one page is described, the others follow it."""
    tifffile.imwrite(path, array, imagej=True, metadata={"axes": "ZYX"}, byteorder="<")
    content = bytearray(path.read_bytes())
    begin, = struct.unpack_from("<I", content, 4)
    n_tags, = struct.unpack_from("<H", content, begin)
    struct.pack_into("<I", content, begin + 2 + 12 * n_tags, 0)
    path.write_bytes(content)
    return path


def write_scattered(path: Path, array: NDArray[Any]) -> Path:
    with tifffile.TiffWriter(path) as writer:
        for plane in array:
            writer.write(plane, metadata=None)
    return path


def write_hdf5(path: Path, array: NDArray[Any], name: str = "entry/data", **keywords: Any) -> Path:
    with h5py.File(path, "w") as file:
        file.create_dataset(name, data=array, **keywords)
        file["entry/angles"] = np.arange(5.0)
        file["entry/flat"] = np.ones((4, 5))
    return path


def write_zarr_2(folder: Path, array: NDArray[Any]) -> Path:
    """Version 2 by hand: chunks of 4 x 5 x 6, deflated, those that stick out filled up."""
    folder.mkdir()
    chunk = (4, 5, 6)
    (folder / ".zarray").write_text(json.dumps({
        "zarr_format": 2, "shape": array.shape, "chunks": chunk, "dtype": array.dtype.newbyteorder("<").str,
        "compressor": {"id": "zlib", "level": 1}, "fill_value": 0, "order": "C", "filters": None}))
    for at in np.ndindex(*[-(-n // c) for n, c in zip(array.shape, chunk, strict=True)]):
        part = array[tuple(slice(k * c, (k + 1) * c) for k, c in zip(at, chunk, strict=True))]
        whole = np.pad(part, [(0, c - n) for c, n in zip(chunk, part.shape, strict=True)])
        (folder / ".".join(map(str, at))).write_bytes(zlib.compress(whole.tobytes()))
    return folder


def write_zarr_3(folder: Path, array: NDArray[Any]) -> Path:
    """Version 3 by hand: a group with one array of one chunk."""
    (folder / "scan/c/0/0").mkdir(parents=True)
    (folder / "zarr.json").write_text('{"zarr_format": 3, "node_type": "group", "attributes": {}}')
    (folder / "scan/zarr.json").write_text(json.dumps({
        "zarr_format": 3, "node_type": "array", "shape": array.shape, "data_type": array.dtype.name, "fill_value": 0,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": array.shape}}, "attributes": {},
        "chunk_key_encoding": {"name": "default"},
        "codecs": [{"name": "bytes", "configuration": {"endian": "big"}}]}))
    (folder / "scan/c/0/0/0").write_bytes(array.astype(array.dtype.newbyteorder(">")).tobytes())
    return folder


def write_nrrd(path: Path, array: NDArray[Any], encode: Callable[[bytes], bytes] = bytes, encoding: str = "raw",
               spacings: str = "1 1 1", head: str = "") -> Path:
    sizes = " ".join(map(str, array.shape[::-1]))
    header = (f"NRRD0004\ntype: {array.dtype.name}\ndimension: 3\nsizes: {sizes}\nspacings: {spacings}\n"
              f"endian: little\nencoding: {encoding}\n{head}\n")
    path.write_bytes(header.encode() + encode(array.tobytes()))
    return path


def write_metaimage(path: Path, array: NDArray[Any], spacing: str = "2 2 2") -> Path:
    """A header with the numbers in a file beside it, big-endian."""
    sizes = " ".join(map(str, array.shape[::-1]))
    element = {"uint16": "MET_USHORT", "int16": "MET_SHORT", "uint8": "MET_UCHAR"}[array.dtype.name]
    path.write_text("ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = True\n"
                    f"DimSize = {sizes}\nElementSpacing = {spacing}\nElementType = {element}\n"
                    f"ElementDataFile = {path.stem}.zraw\n")
    path.with_suffix(".zraw").write_bytes(array.astype(array.dtype.newbyteorder(">")).tobytes())
    return path


def write_mrc(path: Path, array: NDArray[Any]) -> Path:
    header = bytearray(1024)
    # Sizes, mode 6 (uint16), start, sampling, and a cell of as many Angstrom.
    struct.pack_into("<10i3f", header, 0, *array.shape[::-1], 6, 0, 0, 0, *array.shape[::-1], *array.shape[::-1])
    struct.pack_into("<3i", header, 64, 1, 2, 3)
    header[208:216] = b"MAP DD\0\0"
    path.write_bytes(bytes(header) + array.tobytes())
    return path


def write_dicom(folder: Path, array: NDArray[Any], step: float = 0.5, without: int | None = None) -> Path:
    """Slices of CT, explicit little-endian, named against their order."""
    folder.mkdir()
    for number, plane in enumerate(array):
        if number == without:
            continue
        elements = [
            (8, 0x16, "UI", "1.2.840.10008.5.1.4.1.1.2"), (8, 0x18, "UI", f"1.2.3.{number + 1}"), (8, 0x60, "CS", "CT"),
            (0x20, 0xD, "UI", "1.2.3"), (0x20, 0xE, "UI", "1.2.4"), (0x20, 0x13, "IS", str(number)),
            (0x20, 0x32, "DS", f"0\\0\\{step * number}"), (0x20, 0x37, "DS", "1\\0\\0\\0\\1\\0"),
            (0x20, 0x52, "UI", "1.2.5"), (0x28, 2, "US", 1), (0x28, 4, "CS", "MONOCHROME2"),
            (0x28, 0x10, "US", plane.shape[0]), (0x28, 0x11, "US", plane.shape[1]), (0x28, 0x30, "DS", "0.5\\0.5"),
            (0x28, 0x100, "US", 16), (0x28, 0x101, "US", 16), (0x28, 0x102, "US", 15),
            (0x28, 0x103, "US", int(plane.dtype.kind == "i"))]
        syntax = _element(2, 0x10, "UI", "1.2.840.10008.1.2.1")
        pixels = struct.pack("<HH2sHI", 0x7FE0, 0x10, b"OW", 0, plane.nbytes) + plane.tobytes()
        (folder / f"im{len(array) - number}.dcm").write_bytes(
            b"\0" * 128 + b"DICM" + _element(2, 0, "UL", len(syntax)) + syntax
            + b"".join(_element(*element) for element in elements) + pixels)
    return folder


def _element(group: int, number: int, kind: str, value: str | int) -> bytes:
    if isinstance(value, str):
        content = value.encode() + (b"" if len(value) % 2 == 0 else b"\0" if kind == "UI" else b" ")
    else:
        content = struct.pack("<H" if kind == "US" else "<I", value)
    return struct.pack("<HH2sH", group, number, kind.encode(), len(content)) + content


def save(path: Path, array: NDArray[Any]) -> Path:
    np.save(path, array)
    return path


def write_tiff(path: Path, array: NDArray[Any], **keywords: Any) -> Path:
    tifffile.imwrite(path, array, photometric=keywords.pop("photometric", "minisblack"), **keywords)
    return path


WRITERS: dict[str, Callable[[Path, NDArray[Any]], Path]] = {
    "raw": lambda folder, array: write_raw(folder / "a.raw", array),
    "raw_big": lambda folder, array: write_raw(folder / "a", array, "big", offset=129),
    "npy": lambda folder, array: save(folder / "a.npy", array),
    "npy_big": lambda folder, array: save(folder / "b.npy", array.astype(array.dtype.newbyteorder(">"))),
    "tiff": lambda folder, array: write_tiff(folder / "a.tif", array),
    "tiff_plain": lambda folder, array: write_tiff(folder / "b.tif", array, metadata=None),
    "bigtiff": lambda folder, array: write_tiff(folder / "c.tif", array, bigtiff=True, byteorder=">"),
    "ome": lambda folder, array: write_tiff(folder / "a.ome.tif", array, metadata={"axes": "ZYX"}),
    "scattered": lambda folder, array: write_scattered(folder / "d.tif", array),
    "deflated": lambda folder, array: write_tiff(folder / "e.tif", array, compression="zlib", rowsperstrip=3),
    "tiles": lambda folder, array: write_tiff(folder / "f.tif", array, tile=(16, 16)),
    "inverted": lambda folder, array: write_tiff(folder / "g.tif", 65535 - array, photometric="miniswhite"),
    "imagej": lambda folder, array: write_tiff(folder / "h.tif", array, imagej=True, metadata={"axes": "ZYX"}),
    "imagej_large": lambda folder, array: write_large_imagej(folder / "i.tif", array),
    "folder": lambda folder, array: write_slices(folder / "plain", array),
    "folder_deflated": lambda folder, array: write_slices(folder / "deflated", array, compression="zlib"),
    "folder_png": lambda folder, array: write_slices(folder / "png", array, ".png"),
    "hdf5": lambda folder, array: write_hdf5(folder / "a.h5", array),
    "hdf5_chunks": lambda folder, array: write_hdf5(folder / "b.h5", array, chunks=(3, 4, 5), compression="gzip"),
    "hdf5_named": lambda folder, array: Path(f"{write_hdf5(folder / 'c.h5', array)}::entry/data"),
    "hdf5_of_one_time": lambda folder, array: write_hdf5(folder / "d.h5", array[None, None]),
    "zarr_2": lambda folder, array: write_zarr_2(folder / "a.zarr", array),
    "zarr_3": lambda folder, array: write_zarr_3(folder / "b.zarr", array),
    "zarr_named": lambda folder, array: Path(f"{write_zarr_3(folder / 'c.zarr', array)}::scan"),
    "nrrd": lambda folder, array: write_nrrd(folder / "a.nrrd", array),
    "nrrd_deflated": lambda folder, array: write_nrrd(folder / "b.nrrd", array, _gzip, "gzip"),
    "metaimage": lambda folder, array: write_metaimage(folder / "a.mhd", array),
    "mrc": lambda folder, array: write_mrc(folder / "a.mrc", array),
    "dicom": lambda folder, array: write_dicom(folder / "dicom", array),
}
NEEDED = {"zarr": "zarr", "nrrd": "SimpleITK", "metaimage": "SimpleITK", "mrc": "SimpleITK", "dicom": "SimpleITK"}


def _gzip(content: bytes) -> bytes:
    packer = zlib.compressobj(wbits=31)
    return packer.compress(content) + packer.flush()


@st.composite
def boxes(draw: st.DrawFn) -> Window:
    lower = [draw(st.integers(0, n - 1)) for n in SHAPE[::-1]]
    upper = [draw(st.integers(first + 1, n)) for first, n in zip(lower, SHAPE[::-1], strict=True)]
    return Window(tuple(lower), tuple(upper))


@pytest.fixture(scope="module", params=WRITERS)
def opened(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> ImageSource:
    need = next((package for kind, package in NEEDED.items() if request.param.startswith(kind)), None)
    if need is not None:
        pytest.importorskip(need)
    source = hold_source(WRITERS[request.param](tmp_path_factory.mktemp(request.param), voxels()), 3)
    # As it reaches other ranks.
    copy: ImageSource = pickle.loads(pickle.dumps(source))
    return copy


@settings(max_examples=25)
@given(box=boxes())
def test_every_box_of_every_format_is_that_of_the_whole(opened: ImageSource, box: Window) -> None:
    assert (opened.saturation, opened.extent) == (65535.0, Window.of_size(*SHAPE[::-1]))
    read = opened.read(box)
    np.testing.assert_array_equal(read, voxels()[opened.extent.locate(box)])
    assert read.dtype == np.uint16
    assert read.strides[-1] == read.itemsize
    assert read.flags.c_contiguous or isinstance(opened, ArraySource)


@pytest.mark.parametrize("dtype", volume_file.TYPES)
def test_all_types_keep_their_values(tmp_path: Path, dtype: str) -> None:
    array = voxels(dtype)
    paths = [write_raw(tmp_path / "a.raw", array, "big"), save(tmp_path / "a.npy", array),
             write_tiff(tmp_path / "a.tif", array),
             write_hdf5(tmp_path / "a.h5", array.astype(array.dtype.newbyteorder(">")))]
    for path in paths:
        source = hold_source(path, 3)
        read = source.read(source.extent)
        np.testing.assert_array_equal(read, array)
        assert read.dtype == np.dtype(dtype)
        assert source.saturation == (None if read.dtype.kind == "f" else np.iinfo(dtype).max)


def test_grey_levels_of_ct_reach_the_kernels_as_values(tmp_path: Path) -> None:
    array = voxels("int16")
    window = Window((2, 1, 1), (9, 8, 6))
    source = hold_source(write_raw(tmp_path / "a.raw", array, "big"), 3)
    values = read_values(source, window)
    np.testing.assert_array_equal(values.values[values.window.grow(values.margin).locate(window)],
                                  array[Window.of_size(*SHAPE[::-1]).locate(window)])
    same = read_coefficients(ArraySource(Path("a"), array.astype(np.float32)), window)
    np.testing.assert_array_equal(read_coefficients(source, window).coefficients, same.coefficients)


def test_masks_of_truth_values_are_zero_and_one(tmp_path: Path) -> None:
    mask = voxels() > 30_000
    extent = Window.of_size(*SHAPE[::-1])
    for path in (save(tmp_path / "m.npy", mask), write_tiff(tmp_path / "m.tif", mask),
                 write_slices(tmp_path / "m", mask.astype(np.uint8) * 255, ".png")):
        np.testing.assert_array_equal(read_mask(path, extent), mask)
        box = Window((1, 2, 3), (5, 6, 7))
        np.testing.assert_array_equal(open_mask(path, extent).read(box) != 0, mask[extent.locate(box)])
    with pytest.raises(InputError, match=r"m\.npy: the mask is 13 x 11 x 7 px, but its image is 13 x 11 x 8 px"):
        open_mask(tmp_path / "m.npy", Window.of_size(13, 11, 8))


@pytest.mark.parametrize("kind", ["raw", "bigtiff"])
def test_voxels_beyond_2_to_the_31_are_those_asked_for(tmp_path: Path, kind: str) -> None:
    # 2.2e9 voxels of 2 bytes, next to none of which are on the disk.
    side = 1300
    path = tmp_path / f"a.{kind}"
    if kind == "raw":
        with path.open("wb") as file:
            file.truncate(2 * side**3)
        path.with_name("a.raw.toml").write_text(f'shape = [{side}, {side}, {side}]\ntype = "uint16"\n')
        offset = 0
    else:
        offset = tifffile.memmap(path, shape=(side, side, side), dtype=np.uint16, photometric="minisblack",
                                 metadata=None, bigtiff=True).offset
    corner = np.random.default_rng(2).integers(1, 60_000, (2, 3, 4), dtype=np.uint16)
    with path.open("r+b") as file:
        for z, y in np.ndindex(2, 3):
            file.seek(offset + 2 * (((side - 2 + z) * side + side - 3 + y) * side + side - 4))
            file.write(corner[z, y].tobytes())
    source = hold_source(path, 3)
    assert source.extent.n_pixels > 2**31
    np.testing.assert_array_equal(source.read(Window((side - 4, side - 3, side - 2), (side, side, side))), corner)
    assert not source.read(Window((0, 0, side - 2), (50, 60, side))).any()


@pytest.mark.real_data
def test_snow_is_read_as_tifffile_reads_it(real_data: Path) -> None:
    path = real_data / "snow" / "snow.tif"
    whole = tifffile.imread(path)
    source = hold_source(path, 3)
    assert isinstance(source, VolumeFile)
    assert isinstance(source.reader, Planes)
    assert (source.extent.sizes, source.dtype) == ((100, 100, 100), np.uint16)
    rng = np.random.default_rng(3)
    for lower in rng.integers(0, 99, (50, 3)):
        box = Window.between(lower, rng.integers(lower + 1, 101))
        np.testing.assert_array_equal(source.read(box), whole[source.extent.locate(box)])


def test_a_file_that_shrinks_while_it_is_in_use_is_an_error_and_no_signal(tmp_path: Path) -> None:
    for path in (write_raw(tmp_path / "a.raw", voxels()), save(tmp_path / "a.npy", voxels()),
                 write_tiff(tmp_path / "a.tif", voxels()),
                 write_tiff(tmp_path / "b.tif", voxels(), compression="zlib")):
        source = hold_source(path, 3)
        os.truncate(path, path.stat().st_size // 2)
        with pytest.raises(InputError, match=rf"{path.name}: (cannot be read|damaged)"):
            source.read(source.extent)


def test_compressed_files_are_told_from_plain_ones(tmp_path: Path) -> None:
    for path, is_compressed in ((write_raw(tmp_path / "a.raw", voxels()), False),
                                (write_tiff(tmp_path / "a.tif", voxels(), compression="zlib"), True),
                                (write_slices(tmp_path / "png", voxels(), ".png"), True),
                                (write_slices(tmp_path / "tif", voxels()), False),
                                (write_hdf5(tmp_path / "a.h5", voxels()), False)):
        source = hold_source(path, 3)
        assert isinstance(source, VolumeFile)
        assert source.is_compressed is is_compressed


def test_an_image_stays_one_where_images_are_opened(tmp_path: Path) -> None:
    path = write_tiff(tmp_path / "a.tif", voxels())
    with pytest.warns(UserWarning, match="7 pages, only the first is used"):
        image, pixels = open_source(path, 2)
    assert pixels is None
    np.testing.assert_array_equal(image.read(image.extent), voxels()[0])


def cut(path: Path, share: float = 0.9) -> Path:
    for part in (list_parts(path)[-1:] if path.is_dir() else [path]):
        os.truncate(part, int(part.stat().st_size * share))
    return path


def with_text(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def with_sidecar(folder: Path, **said: Any) -> Path:
    return write_raw(folder / "a.raw", voxels(), **said)


def with_key(folder: Path, line: str) -> Path:
    path = write_raw(folder / "a.raw", voxels())
    with_text(folder / "a.raw.toml", f'shape = [13, 11, 7]\ntype = "uint16"\n{line}\n')
    return path


def unlike(folder: Path) -> Path:
    path = write_slices(folder / "s", voxels())
    tifffile.imwrite(path / "slice_9.tif", voxels()[0][:, :-1])
    return path


def without(folder: Path, number: int) -> Path:
    path = write_slices(folder / "s", voxels())
    (path / f"slice_{number}.tif").unlink()
    return path


def mixed(folder: Path) -> Path:
    path = write_slices(folder / "s", voxels())
    cv2.imwrite(str(path / "preview.png"), np.zeros((4, 4), np.uint8))
    return path


def two_sizes(path: Path) -> Path:
    with tifffile.TiffWriter(path) as writer:
        for plane in (*voxels(), voxels()[0][:5]):
            writer.write(plane, metadata=None)
    return path


def with_sides(path: Path) -> Path:
    write_hdf5(path, voxels())
    with h5py.File(path, "r+") as file:
        file["entry/data"].attrs["element_size_um"] = [2.0, 1.0, 1.0]
    return path


def two_arrays(path: Path) -> Path:
    write_hdf5(path, voxels())
    with h5py.File(path, "r+") as file:
        file["entry/mask"] = voxels() > 5
    return path


REFUSED: dict[str, tuple[Callable[[Path], Path], str]] = {
    "missing": (lambda f: f / "a.raw", r"a\.raw: no such volume"),
    "text": (lambda f: with_text(f / "a.txt", "no volume"), r"a\.txt: no volume; give a TIFF file of many pages"),
    "no sidecar": (lambda f: with_text(f / "a.raw", "0" * 99),
                   r"a\.raw: no volume; .* a file a\.raw\.toml that says shape = \[x, y, z\] and type = \"uint16\""),
    "image": (lambda f: write_slices(f / "s", voxels(), ".png") / "slice_5.png", r"slice_5\.png: no volume; .*slices"),
    "raw cut": (lambda f: cut(write_raw(f / "a.raw", voxels())),
                r"a\.raw: 13 x 11 x 7 voxels of uint16 after 0 bytes make a file of 2002 bytes, but it has 1801"),
    "raw long": (lambda f: with_sidecar(f, shape=[13, 11, 6]), r"a\.raw: .* a file of 1716 bytes, but it has 2002"),
    "shape of two": (lambda f: with_sidecar(f, shape=[13, 11]), r"a\.raw\.toml: shape = \[x, y, z\].* expected"),
    "shape of none": (lambda f: with_sidecar(f, shape=None), r"a\.raw\.toml: shape = "),
    "shape of zero": (lambda f: with_sidecar(f, shape=[13, 11, 0]), r"a\.raw\.toml: shape = "),
    "type": (lambda f: with_sidecar(f, type="complex64"), r"a\.raw\.toml: type = one of uint8, .* expected"),
    "order": (lambda f: with_sidecar(f, byte_order="middle"), r"a\.raw\.toml: byte_order = \"little\" or \"big\""),
    "offset": (lambda f: with_key(f, "offset = -1"), r"a\.raw\.toml: offset = "),
    "unknown key": (lambda f: with_sidecar(f, spacing=[1, 1, 1]), r"a\.raw\.toml: shape, type, .* alone expected"),
    "no toml": (lambda f: with_key(f, "order ="), r"a\.raw\.toml: not valid TOML"),
    "npy of two axes": (lambda f: save(f / "a.npy", voxels()[0]), r"a\.npy: an array of shape \(11, 13\), \(z, y, x\)"),
    "npy of fortran": (lambda f: save(f / "a.npy", np.asfortranarray(voxels())), r"Fortran's order.*ascontiguousarray"),
    "npy complex": (lambda f: save(f / "a.npy", voxels().astype(complex)), r"a\.npy: values of type complex128"),
    "npy of objects": (lambda f: save(f / "a.npy", voxels().astype(object)), r"a\.npy: no volume that can be read"),
    "npy cut": (lambda f: cut(save(f / "a.npy", voxels())), r"a\.npy: no volume that can be read, or damaged"),
    "tiff cut": (lambda f: cut(write_tiff(f / "a.tif", voxels())), r"a\.tif: (cut short|damaged)"),
    "tiff deflated cut": (lambda f: cut(write_tiff(f / "a.tif", voxels(), compression="zlib")),
                          r"a\.tif: (cut short|damaged)"),
    "imagej cut": (lambda f: cut(write_large_imagej(f / "a.tif", voxels()), 0.5),
                   r"a\.tif: one page, or a stack cut short"),
    "stack cut": (lambda f: cut(write_tiff(f / "a.tif", voxels(), truncate=True), 0.5),
                  r"a\.tif: cut short, or damaged: its header claims 7 pages"),
    "one page": (lambda f: write_tiff(f / "a.tif", voxels()[0]), r"a\.tif: one page, .* the folder of its slices"),
    "unlike pages": (lambda f: two_sizes(f / "a.tif"), r"a\.tif: page 8 has another size or type than the first"),
    "channels": (lambda f: write_tiff(f / "a.tif", np.stack([voxels()] * 2, 1), imagej=True, metadata={"axes": "ZCYX"}),
                 r"a\.tif: a stack of axes ZCYX; save one channel"),
    "colour pages": (lambda f: write_tiff(f / "a.tif", np.stack([voxels()] * 3, -1), photometric="rgb"),
                     r"a\.tif: pages of colours; save grey levels"),
    "imagej flat voxels": (lambda f: write_tiff(f / "a.tif", voxels(), imagej=True, resolution=(2.0, 2.0),
                                                metadata={"axes": "ZYX", "spacing": 1.5}),
                           r"a\.tif: voxels of 0\.5 x 0\.5 x 1\.5 by its header, cubes expected; resample it"),
    "no slices": (lambda f: f, r": a folder of no files; give one of the slices"),
    "mixed": (mixed, r"s: a folder of \.png, \.tif files"),
    "unlike slices": (unlike, r"slice_9\.tif: another size or type than slice_5\.tif"),
    "missing slice": (lambda f: without(f, 8), r"slice_7\.tif: slice_9\.tif follows, by another step than before"),
    "slice cut": (lambda f: cut(write_slices(f / "s", voxels())), r"slice_11\.tif: cut short"),
    "png slice cut": (lambda f: cut(write_slices(f / "s", voxels(), ".png")), r"slice_11\.png: not an image"),
    "colour slices": (lambda f: write_slices(f / "s", np.stack([voxels()] * 3, -1), photometric="rgb"),
                      r"slice_5\.tif: several pages or colours"),
    "named tiff": (lambda f: Path(f"{write_tiff(f / 'a.tif', voxels())}::data"), r"only in HDF5 and Zarr"),
    "hdf5 without": (lambda f: write_hdf5(f / "a.h5", np.ones((3, 4))),
                     r"a\.h5: 0 arrays of axes z, y, x \(entry/angles \(5,\), entry/data \(3, 4\)"),
    "hdf5 of two": (lambda f: two_arrays(f / "a.h5"),
                    r"a\.h5: 2 arrays of axes z, y, x \(entry/data \(7, 11, 13\), entry/mask .*FILE::entry/data"),
    "hdf5 without that": (lambda f: Path(f"{write_hdf5(f / 'a.h5', voxels())}::dta"),
                          r"a\.h5::dta: there is no dta in a\.h5; it holds entry"),
    "hdf5 of channels": (lambda f: write_hdf5(f / "a.h5", np.stack([voxels()] * 2)), r"a\.h5: 0 arrays of axes z, y"),
    "hdf5 of flat voxels": (lambda f: with_sides(f / "a.h5"), r"a\.h5: voxels of 1 x 1 x 2 by its header"),
    "hdf5 cut": (lambda f: cut(write_hdf5(f / "a.h5", voxels())), r"a\.h5: no volume that can be read, or damaged"),
    "hdf5 complex": (lambda f: write_hdf5(f / "a.h5", voxels().astype(complex)), r"values of type complex128"),
}


@pytest.mark.filterwarnings("ignore:.*colour image")
@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_no_volume_is_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    make, said = REFUSED[kind]
    with pytest.raises(InputError, match=said) as caught:
        open_source(make(tmp_path), 3)
    assert len(str(caught.value).splitlines()) == 1


REFUSED_BY_EXTRAS: dict[str, tuple[str, Callable[[Path], Path], str]] = {
    "zarr of flat voxels": ("zarr", lambda f: _with_ome_scale(write_zarr_3(f / "a.zarr", voxels())),
                            r"a\.zarr: voxels of 1 x 1 x 3 by its header"),
    "zarr without that": ("zarr", lambda f: Path(f"{write_zarr_3(f / 'a.zarr', voxels())}::dta"),
                          r"a\.zarr::dta: there is no dta in a\.zarr; it holds scan"),
    "zarr chunk cut": ("zarr", lambda f: _cut_last_chunk(write_zarr_2(f / "a.zarr", voxels())),
                       r"a\.zarr: cannot be read"),
    "nrrd cut": ("SimpleITK", lambda f: cut(write_nrrd(f / "a.nrrd", voxels())), r"a\.nrrd: cannot be read, damaged"),
    "nrrd of flat voxels": ("SimpleITK", lambda f: write_nrrd(f / "a.nrrd", voxels(), spacings="1 1 2.5"),
                            r"a\.nrrd: voxels of 1 x 1 x 2\.5 by its header"),
    "metaimage cut": ("SimpleITK", lambda f: _cut_voxels(write_metaimage(f / "a.mhd", voxels())),
                      r"a\.mhd: cannot be read"),
    "metaimage alone": ("SimpleITK", lambda f: _remove_voxels(write_metaimage(f / "a.mhd", voxels())),
                        r"a\.mhd: (cannot be read|no volume)"),
    "itk text": ("SimpleITK", lambda f: with_text(f / "a.mha", "no volume"), r"a\.mha: no volume that can be read"),
    "dicom of flat voxels": ("SimpleITK", lambda f: write_dicom(f / "d", voxels(), step=0.8),
                             r"d: voxels of 0\.5 x 0\.5 x 0\.8 by its header"),
    "dicom gap": ("SimpleITK", lambda f: write_dicom(f / "d", voxels(), without=3), r"d: voxels of 0\.5 x 0\.5 x 1 "),
    "no dicom": ("SimpleITK", lambda f: with_text(f / "a.dat", "no slice").parent, r"0 series of DICOM files"),
}


def _with_ome_scale(folder: Path) -> Path:
    said = [{"type": "translation", "translation": [1.0, 1.0, 1.0]}, {"type": "scale", "scale": [3.0, 1.0, 1.0]}]
    # Versions up to 0.3 say none.
    scale = [{"path": "other"}, {"path": "scan", "coordinateTransformations": said}]
    (folder / "zarr.json").write_text(json.dumps({
        "zarr_format": 3, "node_type": "group", "attributes": {"ome": {"multiscales": [{"datasets": scale}]}}}))
    return folder


def _cut_last_chunk(folder: Path) -> Path:
    cut(folder / "1.2.2")
    return folder


def _cut_voxels(path: Path) -> Path:
    cut(path.with_suffix(".zraw"))
    return path


def _remove_voxels(path: Path) -> Path:
    path.with_suffix(".zraw").unlink()
    return path


@pytest.mark.parametrize("kind", REFUSED_BY_EXTRAS)
def test_what_extras_cannot_read_is_refused_in_one_line(tmp_path: Path, kind: str,
                                                        capfd: pytest.CaptureFixture[str]) -> None:
    package, make, said = REFUSED_BY_EXTRAS[kind]
    pytest.importorskip(package)
    with pytest.raises(InputError, match=said) as caught:
        open_source(make(tmp_path), 3)
    assert len(str(caught.value).splitlines()) == 1
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(("package", "extra", "write"), [
    ("zarr", "zarr", lambda f: write_zarr_2(f / "a.zarr", voxels())),
    ("SimpleITK", "itk", lambda f: write_nrrd(f / "a.nrrd", voxels())),
    ("SimpleITK", "itk", lambda f: write_dicom(f / "d", voxels()))])
def test_a_missing_package_is_named_with_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str,
                                                   extra: str, write: Callable[[Path], Path]) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError, match=rf"{package} is needed to read it: pip install 'ddic\[{extra}\]'"):
        open_source(write(tmp_path), 3)


def test_what_can_only_be_decoded_whole_has_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("SimpleITK")
    path = write_nrrd(tmp_path / "a.nrrd", voxels(), _gzip, "gzip")
    volume, held = open_source(path, 3)
    np.testing.assert_array_equal(held, voxels())
    assert isinstance(volume, VolumeFile)
    monkeypatch.setattr(image_formats, "MOST_PIXELS_DECODED", voxels().size - 1)
    with pytest.raises(InputError, match=r"13 x 11 x 7 px in a format that can only be decoded whole"):
        open_source(path, 3)


def test_a_tiff_without_a_codec_is_not_called_damaged(tmp_path: Path) -> None:
    # OpenCV compresses by LZW, which tifffile alone does not decode.
    cv2.imwritemulti(str(tmp_path / "a.tif"), list(voxels()))
    if image_formats.can_decode(tmp_path / "a.tif"):
        pytest.skip("imagecodecs is installed")
    with pytest.raises(InputError, match=r"a\.tif: no codec is installed .* install imagecodecs"):
        open_source(tmp_path / "a.tif", 3)


def test_parts_are_the_files_that_make_a_volume(tmp_path: Path) -> None:
    raw = write_raw(tmp_path / "a.raw", voxels())
    folder = write_slices(tmp_path / "s", voxels())
    meta = write_metaimage(tmp_path / "a.mhd", voxels())
    store = write_zarr_2(tmp_path / "a.zarr", voxels())
    hdf5 = write_hdf5(tmp_path / "a.h5", voxels())
    assert list_parts(raw) == [raw, tmp_path / "a.raw.toml"]
    assert list_parts(folder) == [folder / f"slice_{number}.tif" for number in range(5, 12)]
    assert list_parts(meta) == [meta, tmp_path / "a.zraw"]
    assert len(list_parts(store)) == 1 + 2 * 3 * 3
    assert list_parts(Path(f"{hdf5}::entry/data")) == [hdf5]
    assert list_parts(tmp_path / "none.tif") == [tmp_path / "none.tif"]


def test_a_name_with_two_colons_is_that_of_a_file_where_there_is_one(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "a::b.h5", voxels())
    assert split_dataset(path) == (path, "")
    assert split_dataset(tmp_path / "a.h5::entry/data") == (tmp_path / "a.h5", "entry/data")
    assert hold_source(path, 3).extent == Window.of_size(*SHAPE[::-1])


def test_stamps_tell_when_a_slice_or_a_sidecar_changes(tmp_path: Path) -> None:
    folder, raw = write_slices(tmp_path / "s", voxels()), write_raw(tmp_path / "a.raw", voxels())
    stamps = FileStamps.take([folder, raw])
    assert stamps.choose([folder]).list_changes() == []
    time.sleep(0.01)
    tifffile.imwrite(folder / "slice_7.tif", voxels()[0])
    (tmp_path / "a.raw.toml").write_text("offset = 1\n")
    assert [line.split(": ")[0] for line in stamps.list_changes()] == [
        str(folder / "slice_7.tif"), str(tmp_path / "a.raw.toml")]
    assert len(stamps.choose([folder]).list_changes()) == 1


def test_an_image_with_a_thumbnail_is_no_volume(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "scan.tif") as writer:
        for shape in ((40, 50), (8, 10)):
            writer.write(np.zeros(shape, np.uint8), metadata=None)
    assert not is_volume(tmp_path / "scan.tif")
    tifffile.imwrite(tmp_path / "stack.tif", voxels())
    assert is_volume(tmp_path / "stack.tif")

"""Kinds of bad files: images, masks, meshes, partitions, mappings, points, in every place that takes them."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import meshio
import numpy as np
import tifffile
from numpy.typing import NDArray

from accept.trials.trial import (
    CASE_FILE,
    NEAR,
    OF_MESH_FILE,
    ON_CASE,
    PAIR,
    REGULARIZED,
    SIDE,
    Expected,
    Keys,
    Trial,
    change,
)

Pixels = NDArray[Any]
Write = Callable[[Path], None]
WriteImage = Callable[[Path, Pixels], None]
"""Writes a good image in another form."""

Change = Callable[[Pixels], Pixels]

LARGE_PNG, LARGE_TIFF = 30_000, 100_000
"""Sides of large images, pixels."""


def list_file_trials() -> list[Trial]:
    """List files that are wrong in themselves, or do not go with the others."""
    return [*_list_images(), *_list_meshes(), *list_text_trials(), *_list_case_files()]


def list_large_images() -> list[Trial]:
    """List pairs of large images with meshes all over them."""
    return [_large_pair("a PNG of 30,000 x 30,000", LARGE_PNG),
            _large_pair("a sparse TIFF of 100,000 x 100,000", LARGE_TIFF)]


def _large_pair(name: str, side: int) -> Trial:
    mesh = {"structured": {"region": [100, 100, side - 100, side - 100], "element_size": side // 10}}
    case = {**PAIR, "images": {"reference": "odd.tif", "deformed": "odd_2.tif"}, "mesh": mesh}
    edits = tuple(partial(_write_image, "reference.tif", IMAGES[name][0], file) for file in ("odd.tif", "odd_2.tif"))
    return Trial(name, case, edits, expected="refused", n_mistakes=len(edits))


def list_uncoded_images() -> list[Trial]:
    """List images that are intact, and whose codec is not installed with ddic."""
    name = "an intact TIFF of zstandard"
    edit = partial(_write_image, "reference.tif", IMAGES[name][0], "odd.tif")
    return [Trial(name, change(PAIR, ("images", "reference"), "odd.tif"), (edit,), (*ON_CASE, ("info", "odd.tif")),
                  expected="refused")]


def _bytes(content: bytes) -> Write:
    def write(path: Path) -> None:
        path.write_bytes(content)
    return write


def _text(content: str) -> Write:
    return _bytes(content.encode())


def _tiff(pixels: NDArray[Any], **options: Any) -> Write:
    return lambda path: tifffile.imwrite(path, pixels, **options)


def _as_tiff(change_pixels: Change, **options: Any) -> WriteImage:
    return lambda path, pixels: tifffile.imwrite(path, change_pixels(pixels), **options)


def _encoded(ending: str, keep: float = 1.0, colours: int | None = None) -> WriteImage:
    def write(path: Path, pixels: Pixels) -> None:
        content = cv2.imencode(ending, pixels if colours is None else cv2.cvtColor(pixels, colours))[1].tobytes()
        path.write_bytes(content[:int(keep * len(content))])
    return write


def _content(content: bytes) -> WriteImage:
    return lambda path, _: _bytes(content)(path)


def _cut_tiff(path: Path, pixels: Pixels) -> None:
    tifffile.imwrite(path, pixels)
    path.write_bytes(path.read_bytes()[:pixels.size // 2])


def _claiming_png(path: Path, pixels: Pixels) -> None:
    """A header that claims 4e9 x 4e9 pixels, of a right checksum."""
    content = bytearray(cv2.imencode(".png", pixels)[1].tobytes())
    content[16:24] = (4_000_000_000).to_bytes(4, "big") * 2
    content[29:33] = zlib.crc32(content[12:29]).to_bytes(4, "big")
    path.write_bytes(content)


def _claiming_tiff(path: Path, pixels: Pixels) -> None:
    tifffile.imwrite(path, pixels)
    content = path.read_bytes()
    # ImageWidth (256) and ImageLength (257) as 32 bits, little-endian.
    for tag in (256, 257):
        begin = content.index(tag.to_bytes(2, "little"), 8)
        content = content[:begin + 2] + (4).to_bytes(2, "little") + (1).to_bytes(4, "little") + (
            4_000_000_000).to_bytes(4, "little") + content[begin + 12:]
    path.write_bytes(content)


def _large_png(path: Path, pixels: Pixels) -> None:
    """A whole PNG of LARGE_PNG x LARGE_PNG pixels, of 1000 rows again and again; compressing all would take seconds."""
    n_bands = LARGE_PNG // 1000
    band = np.zeros((1000, 1 + LARGE_PNG), np.uint8)
    band[:, 1:] = np.tile(pixels, (1000 // SIDE + 1, LARGE_PNG // SIDE + 1))[:1000, :LARGE_PNG]
    deflate, checksum = zlib.compressobj(1, wbits=-zlib.MAX_WBITS), 1
    rows = band.tobytes()
    packed = deflate.compress(rows) + deflate.flush(zlib.Z_FULL_FLUSH)
    for _ in range(n_bands):
        checksum = zlib.adler32(rows, checksum)
    header = LARGE_PNG.to_bytes(4, "big") * 2 + bytes([8, 0, 0, 0, 0])
    parts = [b"\x78\x01", *[packed] * n_bands, deflate.flush() + checksum.to_bytes(4, "big")]
    chunks = [(b"IHDR", header), *((b"IDAT", part) for part in parts), (b"IEND", b"")]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(
        len(content).to_bytes(4, "big") + kind + content + zlib.crc32(kind + content).to_bytes(4, "big")
        for kind, content in chunks))


def _sparse_tiff(path: Path, pixels: Pixels) -> None:
    """10 GB of zeros, LARGE_TIFF x LARGE_TIFF pixels, which take no room on the disk."""
    side = LARGE_TIFF
    tifffile.imwrite(path, pixels, bigtiff=True)
    with tifffile.TiffFile(path, mode="r+b") as tiff:
        tags = tiff.pages[0].tags
        for name in ("ImageWidth", "ImageLength", "RowsPerStrip"):
            tags[name].overwrite(side)
        tags["StripByteCounts"].overwrite(side * side)
    with path.open("r+b") as stream:
        stream.truncate(path.stat().st_size + side * side)


def _zstandard_tiff(path: Path, pixels: Pixels) -> None:
    """An intact TIFF that is compressed by zstandard, in one block that is kept as it is."""
    content = pixels.tobytes()
    # First bytes of a frame, what its header holds, the size of all, then that of the last block, of kind 0.
    frame = b"\x28\xb5\x2f\xfd\xa0" + len(content).to_bytes(4, "little") + (1 + 8 * len(content)).to_bytes(3, "little")
    tifffile.imwrite(path, pixels, rowsperstrip=len(pixels))
    with tifffile.TiffFile(path, mode="r+b") as tiff:
        tags = tiff.pages[0].tags
        tags["Compression"].overwrite(50000)
        tags["StripOffsets"].overwrite(path.stat().st_size)
        tags["StripByteCounts"].overwrite(len(frame) + len(content))
    with path.open("ab") as stream:
        stream.write(frame + content)


def _with_infinite(pixels: Pixels) -> Pixels:
    changed = pixels.astype(np.float32)
    changed[50, 50] = np.inf
    return changed


NO_SPECKLE: Pixels = np.eye(SIDE, dtype=np.uint8)

IMAGES: Mapping[str, tuple[WriteImage, Expected]] = {
    "another size": (_as_tiff(lambda pixels: pixels[:64, :64]), "refused"),
    "one pixel": (_as_tiff(lambda pixels: pixels[:1, :1]), "refused"),
    "a TIFF cut short": (_cut_tiff, "refused"),
    "a compressed TIFF cut short": (_encoded(".tif", 0.5), "refused"),
    "a PNG cut short": (_encoded(".png", 0.5), "refused"),
    "a JPEG cut short": (_encoded(".jpg", 0.5), "refused"),
    "a BMP cut short": (_encoded(".bmp", 0.5), "refused"),
    "of complex numbers": (_as_tiff(lambda pixels: pixels.astype(np.complex64)), "refused"),
    "of volumes": (_as_tiff(lambda pixels: np.stack([pixels] * 3, 2)[None].repeat(3, 0)), "refused or measured"),
    "of several pages": (_as_tiff(lambda pixels: np.stack([pixels] * 5)), "refused or measured"),
    "of two channels": (_as_tiff(lambda pixels: np.stack([pixels] * 2, 2), photometric="minisblack"),
                        "refused or measured"),
    "in colours with alpha": (_encoded(".png", colours=cv2.COLOR_GRAY2BGRA), "refused or measured"),
    "of bits": (_as_tiff(lambda pixels: pixels > 128), "may fail"),
    "of 12 bits": (_as_tiff(lambda pixels: pixels.astype(np.uint16) * 16), "refused or measured"),
    "signed": (_as_tiff(lambda pixels: pixels.astype(np.int16) - 100), "refused or measured"),
    "of 64 bit integers": (_as_tiff(lambda pixels: pixels.astype(np.int64)), "refused or measured"),
    "of half precision": (_as_tiff(lambda pixels: pixels.astype(np.float16)), "refused or measured"),
    "of nan only": (_as_tiff(lambda pixels: np.full(pixels.shape, np.nan, np.float32)), "may fail"),
    "with an infinite pixel": (_as_tiff(_with_infinite), "refused or measured"),
    "of huge numbers": (_as_tiff(lambda pixels: pixels * np.float64(1e300)), "may fail"),
    "of zeros": (_as_tiff(np.zeros_like), "may fail"),
    "of one grey": (_as_tiff(lambda pixels: np.full_like(pixels, 77)), "may fail"),
    "of noise": (_as_tiff(lambda pixels: np.random.default_rng(5).integers(0, 256, pixels.shape).astype(np.uint8)),
                 "may fail"),
    "a header of 4e9 x 4e9, PNG": (_claiming_png, "refused"),
    "a header of 4e9 x 4e9, TIFF": (_claiming_tiff, "refused"),
    "a TIFF's first bytes": (_content(b"II*\x00"), "refused"),
    "a TIFF whose pages go in a circle": (_content(b"II*\x00\x08\0\0\0\0\0\x08\0\0\0"), "refused"),
    "a PNG of 30,000 x 30,000": (_large_png, "refused"),
    "a sparse TIFF of 100,000 x 100,000": (_sparse_tiff, "refused"),
    "an intact TIFF of zstandard": (_zstandard_tiff, "refused"),
    "nothing but zeros": (_content(bytes(9000)), "refused"),
    "a mesh": (_content(b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"), "refused"),
    "an archive": (_content(b"PK\x03\x04" + bytes(3000)), "refused"),
}
IN_IMAGES: Mapping[Keys, Mapping[str, Any]] = {
    ("images", "reference"): PAIR, ("images", "deformed"): PAIR, ("images", "reference_mask"): PAIR,
    ("images", "deformed_mask"): PAIR, ("images", "at_rest"): PAIR, ("mesh", "structured", "mask"): PAIR,
    ("near", "reference"): NEAR, ("near", "deformed"): NEAR,
}
GOOD_IMAGES: Mapping[Keys, str] = {
    ("images", "reference"): "reference.tif", ("images", "deformed"): "deformed.tif",
    ("images", "at_rest"): "reference.tif", ("near", "reference"): "near_reference.tif",
    ("near", "deformed"): "near_deformed.tif",
}
"""What is changed; where a mask belongs, the good mask."""

OF_SIZE = 2
"""Lines on an image of another size: neither the other image nor the mesh goes with it."""

OF_MAPPING = 4
"""Lines on a mapping file that is another one: each key that it lacks or should not have."""

MASKS = ("reference_mask", "deformed_mask", "mask")


def _list_images() -> Iterator[Trial]:
    for keys, case in IN_IMAGES.items():
        for name, (write, expected) in IMAGES.items():
            # What a mask or a picture at rest shows may be any grey levels, of one page of them.
            may_be = keys[-1] in MASKS and name.startswith(("of ", "in ", "with ", "signed"))
            edits = (partial(_write_image, str(GOOD_IMAGES.get(keys, "mask.png")), write, "odd.tif"),)
            yield Trial(f"{'.'.join(keys)} is {name}", change(case, keys, "odd.tif"), edits,
                        expected="may fail" if may_be else expected, n_mistakes=OF_SIZE)


def _write_image(good: str, write: WriteImage, file: str, folder: Path) -> None:
    pixels = cv2.imread(str(folder / good), cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    write(folder / file, pixels)


def _write(name: str, write: Write, folder: Path) -> None:
    write(folder / name)


def _mesh(points: list[list[float]], **cells: list[list[int]]) -> Write:
    def write(path: Path) -> None:
        flat = [[*point, 0.0][:3] for point in points]
        blocks = [(kind, np.array(nodes)) for kind, nodes in cells.items()]
        tags = [np.zeros(len(nodes), int) for _, nodes in blocks]
        mesh = meshio.Mesh(np.array(flat), blocks, cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags})
        mesh.write(path, file_format="gmsh22", binary=False)
    return write


def _replaced(old: str, new: str, count: int = -1) -> Write:
    def write(path: Path) -> None:
        text = path.with_name("mesh.msh").read_text(encoding="utf-8")
        if old not in text:
            raise ValueError(f"the good mesh has no {old!r}")
        path.write_text(text.replace(old, new, count), encoding="utf-8")
    return write


_SQUARE = [[20.0, 20.0], [70.0, 20.0], [70.0, 70.0], [20.0, 70.0]]
MESHES: Mapping[str, tuple[Write, Expected]] = {
    "no cells": (_mesh(_SQUARE, vertex=[[0]]), "refused"),
    "tetrahedra": (_mesh([*_SQUARE], tetra=[[0, 1, 2, 3]]), "refused"),
    "quadratic triangles": (_mesh([*_SQUARE, [45, 20], [70, 45]], triangle6=[[0, 1, 2, 4, 5, 3]]), "refused"),
    "lines alone": (_mesh(_SQUARE, line=[[0, 1]]), "refused"),
    "a flat cell": (_mesh([[20, 20], [40, 20], [60, 20]], triangle=[[0, 1, 2]]), "refused"),
    "a crossed cell": (_mesh(_SQUARE, quad=[[0, 2, 1, 3]]), "refused"),
    "a cell that is not convex": (_mesh([[20, 20], [70, 20], [30, 30], [20, 70]], quad=[[0, 1, 2, 3]]), "refused"),
    "a cell twice": (_mesh(_SQUARE, quad=[[0, 1, 2, 3], [0, 1, 2, 3]]), "refused"),
    "cells that overlap": (_mesh([*_SQUARE, [30, 30], [80, 30], [80, 80], [30, 80]],
                                 quad=[[0, 1, 2, 3], [4, 5, 6, 7]]), "refused"),
    "three cells at an edge": (_mesh([*_SQUARE, [45, 80], [60, 75]],
                                     triangle=[[0, 1, 2], [0, 2, 3], [0, 2, 4]]), "refused"),
    "a hanging node": (_mesh([[20, 20], [50, 20], [80, 20], [20, 50], [50, 50], [80, 50], [50, 35], [80, 35]],
                             quad=[[0, 1, 4, 3], [1, 2, 7, 6], [6, 7, 5, 4]]), "refused"),
    "a node of nan": (_mesh([[np.nan, 20.0], *_SQUARE[1:]], quad=[[0, 1, 2, 3]]), "refused"),
    "a node at 1e308": (_mesh([[1e308, 20.0], *_SQUARE[1:]], quad=[[0, 1, 2, 3]]), "refused"),
    "cells outside the image": (_mesh([[x + 500, y] for x, y in _SQUARE], quad=[[0, 1, 2, 3]]), "refused"),
    "cells of no pixel": (_mesh([[x / 100, y / 100] for x, y in _SQUARE], quad=[[0, 1, 2, 3]]), "refused"),
    "heights that differ": (_replaced("25 8.0000000000000000e+01 8.0000000000000000e+01 0", "25 80 80 7"), "refused"),
    "a node that does not exist": (_replaced(" 25 24\n$End", " 99 24\n$End"), "refused or measured"),
    "more elements than said": (_replaced("$Elements\n16", "$Elements\n99"), "refused"),
    "fewer elements than said": (_replaced("$Elements\n16", "$Elements\n3"), "refused or measured"),
    "-1 nodes": (_replaced("$Nodes\n25", "$Nodes\n-1"), "refused or measured"),
    "1e18 nodes": (_replaced("$Nodes\n25", "$Nodes\n1000000000000000000"), "refused"),
    "another version": (_replaced("2.2 0 8", "9.9 0 8"), "refused"),
    "no version": (_replaced("$MeshFormat", "$Nonsense", 1), "refused"),
    "words for numbers": (_replaced("16", "sixteen"), "refused"),
    "binary, it says": (_replaced("2.2 0 8", "2.2 1 8"), "refused"),
    "nothing": (_bytes(b""), "refused"),
    "zeros": (_bytes(bytes(5000)), "refused"),
    "an image": (_tiff(NO_SPECKLE), "refused"),
}
ENDINGS = ("msh", "inp", "vtu", "vtk", "stl", "xdmf", "med", "exo", "obj", "nonsense", "")


def _list_meshes() -> Iterator[Trial]:
    for name, (write, expected) in MESHES.items():
        yield Trial(f"mesh.file is {name}", change(OF_MESH_FILE, ("mesh", "file"), "odd.msh"),
                    (partial(_write, "odd.msh", write),), expected=expected)
    for ending in ENDINGS:
        for name, write in (("text", _text("nonsense\n")), ("zeros", _bytes(bytes(2000)))):
            file = f"odd.{ending}" if ending else "odd"
            yield Trial(f"mesh.file = {file} of {name}", change(OF_MESH_FILE, ("mesh", "file"), file),
                        (partial(_write, file, write),), expected="refused")


OF_PARTITION: dict[str, Any] = {**OF_MESH_FILE, "solver": {"method": "dual", "partition": "file",
                                                           "partition_file": "odd.txt"}}
_HALF = ["0"] * 8 + ["1"] * 8
PARTITIONS: Mapping[str, str] = {
    "empty": "", "too few": "0\n1\n", "too many": "0\n" * 40, "negative": "\n".join(["-1", *_HALF[1:]]),
    "with a gap": "\n".join(["7", *_HALF[1:]]), "2e9": "\n".join(["2000000000", *_HALF[1:]]),
    "2^63": "\n".join([str(2**63), *_HALF[1:]]), "2^64": "\n".join([str(2**64), *_HALF[1:]]),
    "halves": "\n".join(["0.5", *_HALF[1:]]), "nan": "\n".join(["nan", *_HALF[1:]]), "words": "zero one two",
    "NUL": "\0" * 16, "comments alone": "# nothing\n" * 16, "5000 digits": "9" * 5000,
    "1e30": "\n".join(["1e30", *_HALF[1:]]), "commas": ",".join(_HALF),
    "two columns": "\n".join(f"{k} {k}" for k in _HALF),
}
POINTS: Mapping[str, str] = {
    "empty": "", "without a header": "20,20,1,1\n", "with a header alone": "x,y,u,v\n", "without v": "x,y,u\n20,20,1\n",
    "of words": "x,y,u,v\na,b,c,d\n", "of nan": "x,y,u,v\nnan,20,1,1\n", "infinite": "x,y,u,v\n20,20,inf,1\n",
    "ragged": "x,y,u,v\n20,20,1\n", "outside": "x,y,u,v\n2000,20,1,1\n", "of NUL": "x,y,u,v\n\0,20,1,1\n",
    "huge": "x,y,u,v\n20,20,1e308,1\n", "with a column twice": "x,x,y,u,v\n20,20,20,1,1\n",
    "with 5000 digits": f"x,y,u,v\n{'9' * 5000},20,1,1\n", "of one place twice": "x,y,u,v\n20,20,1,1\n20,20,9,9\n",
}
MAPPINGS: Mapping[str, str] = {
    "empty": "", "no TOML": "= = =", "of other keys": "nonsense = 1\n", "a case": 'images = {reference = "a"}\n',
    "nested deep": f"a = {'[' * 3000}{']' * 3000}\n", "of 5000 digits": f"a = {'9' * 5000}\n", "of NUL": "\0\0\0",
}


def list_text_trials() -> Iterator[Trial]:
    """List partitions, displacements at points, and mappings."""
    of_points = change(PAIR, ("start", "from_points"), "odd.csv")
    of_mapping = change(NEAR, ("near", "mapping_file"), "odd.toml")
    for case, file, texts in ((OF_PARTITION, "odd.txt", PARTITIONS), (of_points, "odd.csv", POINTS),
                              (of_mapping, "odd.toml", MAPPINGS)):
        for name, text in texts.items():
            yield Trial(f"{file} is {name}", case, (partial(_write, file, _text(text)),),
                        expected="refused or measured" if name in ("commas", "of one place twice") else "refused",
                        n_mistakes=OF_MAPPING if texts is MAPPINGS else 1)
    yield from _list_changed_mappings(of_mapping)


def _list_changed_mappings(case: Mapping[str, Any]) -> Iterator[Trial]:
    """Every line of the good mapping file removed, and with other values."""
    for name, new in (("removed", None), ("nan", "nan"), ("text", '"a"'), ("empty list", "[]"), ("huge", "1e308"),
                      ("zero", "0"), ("negative", "-1")):
        for number in range(12):
            yield Trial(f"line {number} of the mapping file: {name}", case, (partial(_change_line, number, new),))


def _change_line(number: int, new: str | None, folder: Path) -> None:
    lines = (folder / "mapping.toml").read_text(encoding="utf-8").splitlines()
    of_keys = [place for place, line in enumerate(lines) if "=" in line and not line.startswith("#")]
    place = of_keys[number % len(of_keys)]
    lines[place] = "" if new is None else f"{lines[place].partition('=')[0]} = {new}"
    (folder / "odd.toml").write_text("\n".join(lines), encoding="utf-8")


CASES: Mapping[str, bytes] = {
    "empty": b"", "zeros": bytes(300), "no UTF-8": b"title = '\xff'\n", "UTF-16": "title = 'a'".encode("utf-16"),
    "only a title": b"title = 'a'\n", "a section twice": b"[images]\n[images]\n",
    "a key twice": b"title='a'\ntitle='b'\n",
    "unfinished": b"[images\n", "tables nested deep": b"a = " + b"{a = " * 3000 + b"1" + b"}" * 3000,
    "lists nested deep": b"a = " + b"[" * 3000 + b"]" * 3000, "JSON": b'{"images": {}}', "a lone quote": b"title = '''",
    "dates": b"images = 1979-05-27\nmesh = 07:32:00\n", "an image": cv2.imencode(".png", NO_SPECKLE)[1].tobytes(),
    "dotted deep": b"a" + b".a" * 3000 + b" = 1\n", "sections as numbers": b"images = 1\nmesh = 2\n",
}


def _list_case_files() -> Iterator[Trial]:
    for name, content in CASES.items():
        yield Trial(f"the case file is {name}", PAIR, (partial(_write, CASE_FILE, _bytes(content)),),
                    expected="refused", n_mistakes=2)
    for name, prefix in (("a byte-order mark", b"\xef\xbb\xbf"), ("carriage returns", b"\r\n\r\n")):
        yield Trial(f"the case file begins with {name}", PAIR, (partial(_begin_with, prefix),))
    yield Trial("the case file is good", REGULARIZED)


def _begin_with(prefix: bytes, folder: Path) -> None:
    path = folder / CASE_FILE
    path.write_bytes(prefix + path.read_bytes())

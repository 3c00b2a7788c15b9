"""Kinds of bad input of volumes: all keys that images have as well, files of every format, meshes of boxes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import tifffile
from numpy.typing import NDArray

from accept.trials.case_trials import list_command_trials, list_schema_trials
from accept.trials.file_trials import list_text_trials
from accept.trials.trial import BOX, PAIR, VOLUME, Expected, Trial, change

Voxels = NDArray[Any]
Write = Callable[[Path, Voxels], None]
"""Writes something beside the name that a case gives, from the voxels of the good volume."""

NOT_OF_VOLUMES = ("images", "near", "discontinuity", "pgd", "mesh.unstructured", "region", "simulation",
                  "identification", "odd.csv", "odd.toml", "line ")
"""Where names of trials begin that have no counterpart."""

FILES = {"reference.tif": "volume_reference.tif", "deformed.tif": "volume_deformed.tif",
         "deformed_2.tif": "volume_deformed_2.tif", "mask.png": "volume_mask.tif", "mesh.msh": "volume_mesh.vtu",
         "points.csv": "volume_points.csv", "partition.txt": "volume_partition.txt"}
"""Good files of volumes by those of images."""


GOOD: Mapping[str, tuple[str, ...]] = {
    "plot": ("earlier.volume.vtkhdf", "--kind", "residual"), "probe": ("earlier.volume.vtkhdf", "--point", "16,16,16"),
    "export": ("earlier.volume.vtkhdf",), "report": ("earlier.volume.vtkhdf",), "info": ("earlier.volume.vtkhdf",),
}
"""Arguments with which commands succeed."""

POINTS: Mapping[str, str] = {
    "empty": "", "of images": "x,y,u,v\n16,16,1,1\n", "with a header alone": "x,y,z,u,v,w\n",
    "of nan": "x,y,z,u,v,w\nnan,16,16,1,1,1\n", "ragged": "x,y,z,u,v,w\n16,16,16,1,1\n",
    "outside": "x,y,z,u,v,w\n16,16,9999,1,1,1\n", "of words": "x,y,z,u,v,w\na,b,c,d,e,f\n",
}


def _list_points() -> Iterator[Trial]:
    for name, text in POINTS.items():
        yield Trial(f"of volumes: points are {name}", change(VOLUME, ("start", "from_points"), "odd.csv"),
                    (partial(_write_text, text),), expected="refused")


def _write_text(text: str, folder: Path) -> None:
    (folder / "odd.csv").write_text(text, encoding="utf-8")


def list_volume_trials() -> list[Trial]:
    """List all kinds."""
    of_images = [*list_schema_trials(), *list_text_trials()]
    alike = (_to_volume(trial) for trial in of_images if not trial.name.startswith(NOT_OF_VOLUMES))
    of_commands = (replace(trial, case=VOLUME) for trial in list_command_trials(GOOD))
    return [*alike, *_list_files(), *_list_meshes(), *_list_points(), *_list_mistaken(), *of_commands]


def _to_volume(trial: Trial) -> Trial:
    """The same trial with volumes in place of images."""
    case = {"volumes" if section == "images" else section: _replace(value) for section, value in trial.case.items()}
    if case.get("solver") == {"subdomains": 4}:
        case["solver"] = {"subdomains": 2}
    # An input may be a folder of slices: that the result would be written into it is a mistake too.
    is_folder = trial.name.endswith(("the case's folder", "no name"))
    return replace(trial, name=f"of volumes: {trial.name}", case=case, n_mistakes=trial.n_mistakes + is_folder)


def _replace(value: Any) -> Any:
    """A value of a case, in which files and the box of the mesh are a volume's."""
    if isinstance(value, Mapping):
        return {key: _replace(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return BOX if value == PAIR["mesh"]["structured"]["region"] else [_replace(inner) for inner in value]
    return FILES.get(value, value) if isinstance(value, str) else value


def _tiff(change_voxels: Callable[[Voxels], Voxels], **options: Any) -> Write:
    return lambda path, voxels: tifffile.imwrite(path.with_suffix(".tif"), change_voxels(voxels), **options)


def _cut_short(suffix: str, keep: float = 0.5) -> Write:
    def write(path: Path, voxels: Voxels) -> None:
        file = path.with_suffix(suffix)
        if suffix == ".npy":
            np.save(file, voxels)
        elif suffix == ".h5":
            with h5py.File(file, "w") as opened:
                opened.create_dataset("f", data=voxels, chunks=(8, 8, 8), compression="gzip")
        else:
            tifffile.imwrite(file, voxels, compression="zlib" if suffix == ".tiff" else None)
        file.write_bytes(file.read_bytes()[:int(keep * file.stat().st_size)])
    return write


def _raw(sidecar: str | None, keep: float = 1.0) -> Write:
    def write(path: Path, voxels: Voxels) -> None:
        content = voxels.tobytes()
        path.with_suffix(".raw").write_bytes(content[:int(keep * len(content))])
        if sidecar is not None:
            path.with_suffix(".raw.toml").write_text(sidecar, encoding="utf-8")
    return write


def _npy(change_voxels: Callable[[Voxels], Any]) -> Write:
    return lambda path, voxels: np.save(path.with_suffix(".npy"), change_voxels(voxels), allow_pickle=True)


def _hdf5(**arrays: Callable[[Voxels], Any]) -> Write:
    def write(path: Path, voxels: Voxels) -> None:
        with h5py.File(path.with_suffix(".h5"), "w") as opened:
            for name, change_voxels in arrays.items():
                opened[name] = change_voxels(voxels)
    return write


def _folder(*slices: Callable[[Voxels], Any]) -> Write:
    def write(path: Path, voxels: Voxels) -> None:
        path.mkdir()
        for number, change_voxels in enumerate(slices):
            tifffile.imwrite(path / f"{number}.tif", change_voxels(voxels))
    return write


def _bytes(suffix: str, content: bytes) -> Write:
    def write(path: Path, _: Voxels) -> None:
        path.with_suffix(suffix).write_bytes(content)
    return write


def _with_infinite(voxels: Voxels) -> Voxels:
    changed = voxels.astype(np.float32)
    changed[16, 16, 16] = np.inf
    return changed


def _noise(voxels: Voxels) -> Voxels:
    return np.random.default_rng(5).integers(0, 256, voxels.shape).astype(np.uint8)


GOOD_SIDECAR = 'shape = [32, 32, 32]\ntype = "uint8"\n'
VOLUMES: Mapping[str, tuple[str, Write, Expected]] = {
    "another size": ("odd.tif", _tiff(lambda v: v[:20]), "refused"),
    "one voxel": ("odd.tif", _tiff(lambda v: v[:1, :1, :1]), "refused"),
    "an image": ("odd.tif", _tiff(lambda v: v[0]), "refused"),
    "in colours": ("odd.tif", _tiff(lambda v: np.stack([v] * 3, -1), photometric="rgb"), "refused"),
    "of complex numbers": ("odd.tif", _tiff(lambda v: v.astype(np.complex64)), "refused"),
    "signed": ("odd.tif", _tiff(lambda v: v.astype(np.int16) - 100), "refused or measured"),
    "of 32 bit integers": ("odd.tif", _tiff(lambda v: v.astype(np.uint32)), "refused or measured"),
    "of half precision": ("odd.tif", _tiff(lambda v: v.astype(np.float16)), "refused or measured"),
    "of nan only": ("odd.tif", _tiff(lambda v: np.full(v.shape, np.nan, np.float32)), "may fail"),
    "with an infinite voxel": ("odd.tif", _tiff(_with_infinite), "refused or measured"),
    "of huge numbers": ("odd.tif", _tiff(lambda v: v * np.float64(1e300)), "may fail"),
    "of zeros": ("odd.tif", _tiff(np.zeros_like), "may fail"),
    "of noise": ("odd.tif", _tiff(_noise), "may fail"),
    "a stack cut short": ("odd.tif", _cut_short(".tif"), "refused"),
    "a compressed stack cut short": ("odd.tiff", _cut_short(".tiff"), "refused"),
    "raw numbers without a sidecar": ("odd.raw", _raw(None), "refused"),
    "text": ("odd.raw", _bytes(".raw", b"nothing of the kind\n"), "refused"),
    "raw numbers cut short": ("odd.raw", _raw(GOOD_SIDECAR, 0.5), "refused"),
    "good raw numbers": ("odd.raw", _raw(GOOD_SIDECAR), "refused or measured"),
    "a sidecar that is empty": ("odd.raw", _raw(""), "refused"),
    "a sidecar that is no TOML": ("odd.raw", _raw("= = ="), "refused"),
    "a sidecar of two sizes": ("odd.raw", _raw('shape = [32, 1024]\ntype = "uint8"\n'), "refused"),
    "a sidecar of another size": ("odd.raw", _raw('shape = [32, 32, 31]\ntype = "uint8"\n'), "refused"),
    "a sidecar of size -1": ("odd.raw", _raw('shape = [32, 32, -32]\ntype = "uint8"\n'), "refused"),
    "a sidecar of 2^62 voxels": ("odd.raw", _raw('shape = [4294967296, 1073741824, 1]\ntype = "uint8"\n'), "refused"),
    "a sidecar of another type": ("odd.raw", _raw('shape = [32, 32, 32]\ntype = "uint16"\n'), "refused"),
    "a sidecar of no type": ("odd.raw", _raw('shape = [32, 32, 32]\ntype = "colour"\n'), "refused"),
    "a sidecar with other keys": ("odd.raw", _raw(GOOD_SIDECAR + "shapes = 1\n"), "refused"),
    "a sidecar of offset nan": ("odd.raw", _raw(GOOD_SIDECAR + "offset = nan\n"), "refused"),
    "an array cut short": ("odd.npy", _cut_short(".npy"), "refused"),
    "an array of a plane": ("odd.npy", _npy(lambda v: v[0]), "refused"),
    "an array of four dimensions": ("odd.npy", _npy(lambda v: v[None]), "refused"),
    "an array of texts": ("odd.npy", _npy(lambda v: np.full(v.shape, "a")), "refused"),
    "an array of objects": ("odd.npy", _npy(lambda v: np.array([{"a": 1}] * 8).reshape(2, 2, 2)), "refused"),
    "an array in Fortran's order": ("odd.npy", _npy(np.asfortranarray), "refused"),
    "an array of nothing": ("odd.npy", _npy(lambda v: v[:0]), "refused"),
    "HDF5 of two arrays, none named": ("odd.h5", _hdf5(a=lambda v: v, b=lambda v: v), "refused"),
    "HDF5, another array": ("odd.h5::nothing", _hdf5(f=lambda v: v), "refused"),
    "HDF5, a group of two": ("odd.h5::f", _hdf5(**{"f/a": lambda v: v, "f/b": lambda v: v}), "refused"),
    "HDF5 of a plane": ("odd.h5::f", _hdf5(f=lambda v: v[0]), "refused"),
    "HDF5 of texts": ("odd.h5::f", _hdf5(f=lambda v: np.full((4, 4, 4), b"a")), "refused"),
    "HDF5 cut short": ("odd.h5::f", _cut_short(".h5"), "refused"),
    "good HDF5": ("odd.h5::f", _hdf5(f=lambda v: v), "refused or measured"),
    "an array's name in TIFF": ("odd.tif::f", _tiff(lambda v: v), "refused"),
    "an empty folder": ("odd", _folder(), "refused"),
    "a folder of one slice": ("odd", _folder(lambda v: v[0]), "refused"),
    "slices of two sizes": ("odd", _folder(lambda v: v[0], lambda v: v[0, :20]), "refused"),
    "slices of two types": ("odd", _folder(lambda v: v[0], lambda v: v[0].astype(np.uint16)), "refused"),
    "DICOM, ITK not installed, or damaged": ("odd.dcm", _bytes(".dcm", bytes(900)), "refused"),
    "NRRD, ITK not installed, or damaged": ("odd.nrrd", _bytes(".nrrd", b"NRRD0004\n"), "refused"),
}
OF_SIZE, OF_SIDECAR = 2, 5
"""Lines on a volume of another size, and on a sidecar: one for each of its keys."""


def _list_files() -> Iterator[Trial]:
    for key, good in (("reference", "volume_reference.tif"), ("deformed", "volume_deformed.tif"),
                      ("mask", "volume_mask.tif")):
        for name, (path, write, expected) in VOLUMES.items():
            may_be = key == "mask" and name.startswith(("of ", "with ", "signed"))
            yield Trial(f"volumes.{key} is {name}", change(VOLUME, ("volumes", key), path),
                        (partial(_write, good, write),), expected="may fail" if may_be else expected,
                        n_mistakes=OF_SIDECAR if "sidecar" in name else OF_SIZE)


def _write(good: str, write: Write, folder: Path) -> None:
    write(folder / "odd", tifffile.imread(folder / good))


CORNERS = [[x, y, z] for z in (6.0, 26.0) for y in (6.0, 26.0) for x in (6.0, 26.0)]
HEX = [0, 1, 3, 2, 4, 5, 7, 6]
FAR = [[x + 500, y, z] for x, y, z in CORNERS]


def _mesh(points: list[list[float]], **cells: list[list[int]]) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        blocks = [(kind, np.array(nodes)) for kind, nodes in cells.items()]
        tags = [np.zeros(len(nodes), int) for _, nodes in blocks]
        mesh = meshio.Mesh(np.array(points), blocks, cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags})
        mesh.write(folder / "odd.msh", file_format="gmsh22", binary=False)
    return write


_EDGE = [[16.0, 6.0, 6.0]]
MESHES: Mapping[str, Callable[[Path], None]] = {
    "plane": _mesh(CORNERS, quad=[[0, 1, 3, 2]]),
    "points alone": _mesh(CORNERS, vertex=[[0]]),
    "quadratic tetrahedra": _mesh([*CORNERS, *_EDGE, *_EDGE], tetra10=[[0, 1, 2, 4, 8, 3, 5, 6, 7, 9]]),
    "wedges": _mesh(CORNERS, wedge=[[0, 1, 2, 4, 5, 6]]),
    "pyramids": _mesh(CORNERS, pyramid=[[0, 1, 3, 2, 4]]),
    "a flat tetrahedron": _mesh(CORNERS, tetra=[[0, 1, 2, 3]]),
    "a crossed box": _mesh(CORNERS, hexahedron=[[0, 3, 1, 2, 4, 5, 7, 6]]),
    "a box twice": _mesh(CORNERS, hexahedron=[HEX, HEX]),
    "boxes that overlap": _mesh([*CORNERS, *([x + 1.0, y + 1.0, z + 1.0] for x, y, z in CORNERS)],
                                hexahedron=[HEX, [8 + n for n in HEX]]),
    "a hanging node": _mesh([*CORNERS, [26.0, 16.0, 6.0], [28.0, 6.0, 6.0], [28.0, 16.0, 26.0]],
                            hexahedron=[HEX], tetra=[[1, 9, 8, 10]]),
    "a node of nan": _mesh([[np.nan, 6.0, 6.0], *CORNERS[1:]], hexahedron=[HEX]),
    "a node at 1e308": _mesh([[1e308, 6.0, 6.0], *CORNERS[1:]], hexahedron=[HEX]),
    "outside the volume": _mesh(FAR, hexahedron=[HEX]),
    "cells of no voxel": _mesh([[x / 100, y / 100, z / 100] for x, y, z in CORNERS], hexahedron=[HEX]),
}


def _list_meshes() -> Iterator[Trial]:
    for name, write in MESHES.items():
        yield Trial(f"of volumes: mesh.file is {name}", {**VOLUME, "mesh": {"file": "odd.msh"}}, (write,),
                    expected="refused")


def _list_mistaken() -> Iterator[Trial]:
    """What does not go with volumes, and beside good ones."""
    beside: Mapping[str, Mapping[str, Any]] = {
        "images": {"images": PAIR["images"]}, "near": {"near": [{"reference": "a.tif", "deformed": "b.tif"}]},
        "discontinuity": {"discontinuity": [{"vertices": [[48.0, 10.0], [48.0, 86.0]]}]},
        "pgd": {"pgd": {"output_spacing": 16.0}},
        "unstructured": {"mesh": {"unstructured": {"region": BOX, "element_size": 8}}},
        "a box of four numbers": {"mesh": {"structured": {"region": BOX[:4], "element_size": 8}}},
        "a box of six numbers beside images": {"images": PAIR["images"], "volumes": None},
        "a circle": {"mesh": {"structured": {"region": {"center": [16, 16], "radius": 9}, "element_size": 8}}},
        "quintic splines": {"correlation": {"spline_degree": 5}},
        "plane strain": {"regularization": {"cut_off_wavelength": 32.0, "plane": "strain"}},
        "orthotropy": {"regularization": {"cut_off_wavelength": 32.0, "young_ratio": 2.0}},
        "flip_y": {"output": {"file": "result.vtkhdf", "flip_y": True}},
        "matching without regularization": {"solver": {"method": "matching"}},
    }
    for name, sections in beside.items():
        case = {key: value for key, value in {**VOLUME, **sections}.items() if value is not None}
        yield Trial(f"volumes beside {name}", case, expected="refused", n_mistakes=3)
    for command in (("view", "earlier.volume.vtkhdf"), ("draw", "volume_reference.tif", "case.toml"),
                    ("uncertainty", "case.toml")):
        yield Trial(f"ddic {command[0]} of volumes", VOLUME, commands=(command,), expected="refused")
    yield Trial("the case of volumes is good", {**VOLUME, "regularization": {"cut_off_wavelength": 32.0}})

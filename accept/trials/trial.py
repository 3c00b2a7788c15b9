"""What is tried: a small change to a good small case of every sort, the commands that meet it, what may come of it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import cv2
import meshio
import numpy as np
import tifffile

from bench.support.runs import ddic, source_version
from ddic.io.mesh_file import write_mesh
from ddic.mesh.grid import GridLines

CASE_FILE = "case.toml"
ON_CASE: tuple[tuple[str, ...], ...] = (("check", CASE_FILE), ("run", CASE_FILE))

Keys = tuple[str, ...]
"""That lead to a value, from outside in."""

Edit = Callable[[Path], None]
"""Changes files in the folder of a good case."""

Expected = Literal["refused", "refused or measured", "may fail", "ends"]


@dataclass(frozen=True)
class Raw:
    """TOML text that stands for a value as it is written.

    Attributes
    ----------
    text : str
        Of the value, which need not be valid.
    """

    text: str


@dataclass(frozen=True)
class Trial:
    """One kind of input.

    Attributes
    ----------
    name : str
        What is changed, and to what.
    case : mapping
        The case file's sections; a ``Raw`` stands as it is.
    edits : tuple of Edit
        What is changed beside the case file.
    commands : tuple of tuple of str
        Arguments of ``ddic``, one command after the other.
    expected : str
        "refused": exit code 2; "refused or measured": 0 with a result where the input is legal after all; "may
        fail": 1 too, where it is legal and shows nothing that could be measured; "ends": no
        more than that the command ends in order, for damage that may leave a file whole.
    environment : mapping
        Variables of the environment that differ.
    n_mistakes : int
        Most lines that tell of them: each wrong entry of a list may have its own.
    """

    name: str
    case: Mapping[str, Any]
    edits: tuple[Edit, ...] = ()
    commands: tuple[tuple[str, ...], ...] = ON_CASE
    expected: Expected = "refused or measured"
    environment: Mapping[str, str] = field(default_factory=dict)
    n_mistakes: int = 1

    def write(self, folder: Path) -> None:
        """Write the case file and change what is beside it."""
        (folder / CASE_FILE).write_text(write_toml(self.case), encoding="utf-8", errors="surrogatepass")
        for edit in self.edits:
            edit(folder)


def write_toml(case: Mapping[str, Any]) -> str:
    """Write sections as TOML, one line each."""
    return "".join(f"{_write_key(key)} = {_write_value(value)}\n" for key, value in case.items())


def _write_key(key: str) -> str:
    return key if key.isidentifier() and key.isascii() else json.dumps(key)


def _write_value(value: Any) -> str:
    if isinstance(value, Raw):
        return value.text
    if isinstance(value, Mapping):
        inside = ", ".join(f"{_write_key(key)} = {_write_value(item)}" for key, item in value.items())
        return f"{{{inside}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_write_value, value))}]"
    if isinstance(value, str):
        return json.dumps(value).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value)


def change(case: Mapping[str, Any], keys: tuple[str, ...], value: Any) -> dict[str, Any]:
    """Give a case in which one key has another value."""
    first, *rest = keys
    if not rest:
        return {**case, first: value}
    inner = case.get(first, {})
    if isinstance(inner, list):
        return {**case, first: [change(inner[0] if inner else {}, tuple(rest), value), *inner[1:]]}
    return {**case, first: change(inner, tuple(rest), value)}


SIDE = 96
"""Of the images, pixels: a measurement of them takes a fraction of a second."""

VOLUME_SIDE = 32
"""Of the volumes, voxels."""

SMALL = ("--size", f"{SIDE}x{SIDE}", "--seed", "3")
LOW, HIGH, ELEMENT = 16, 80, 16

PAIR: dict[str, Any] = {
    "images": {"reference": "reference.tif", "deformed": "deformed.tif"},
    "mesh": {"structured": {"region": [LOW, LOW, HIGH, HIGH], "element_size": ELEMENT}},
    "output": {"file": "result.vtkhdf"},
}
OF_MESH_FILE: dict[str, Any] = {**PAIR, "mesh": {"file": "mesh.msh", "mapping": {"scale": 1.0}}}
REGULARIZED: dict[str, Any] = {**PAIR, "regularization": {"cut_off_wavelength": 64.0}, "solver": {"subdomains": 4}}
SERIES: dict[str, Any] = {**PAIR, "images": {**PAIR["images"], "deformed": ["deformed.tif", "deformed_2.tif"]},
                          "series": {"start": "last"}}
PGD: dict[str, Any] = {**PAIR, "pgd": {"output_spacing": 16.0}}
CUT: dict[str, Any] = {**PAIR, "discontinuity": [{"vertices": [[48.0, 10.0], [48.0, 86.0]]}]}
NEAR: dict[str, Any] = {
    **PAIR,
    "images": {"reference": "far_reference.tif", "deformed": "far_deformed.tif"},
    "mesh": {"structured": {"region": [8, 8, 88, 88], "element_size": 8}},
    "near": [{"reference": "near_reference.tif", "deformed": "near_deformed.tif", "mapping_file": "mapping.toml"}],
}
COMPARED: dict[str, Any] = {**PAIR, "simulation": {"file": "simulated.vtu"}}
IDENTIFIED: dict[str, Any] = {
    **PAIR,
    "images": {**PAIR["images"], "pixel_size": 0.1, "length_unit": "mm"},
    "region": [{"name": "left", "shape": [LOW, LOW, 48, HIGH]}],
    "identification": {"material": [{"law": "isotropic"}], "thickness": 2.0,
                       "force": [{"nodes": "top", "direction": [0, -1], "value": 100.0, "deviation": 1.0}]},
}
BOX = [4, 4, 4, 28, 28, 28]
"""Of the mesh in a volume of VOLUME_SIDE voxels a side."""

VOLUME: dict[str, Any] = {
    "volumes": {"reference": "volume_reference.tif", "deformed": "volume_deformed.tif"},
    "mesh": {"structured": {"region": BOX, "element_size": 8}},
    "output": {"file": "result.vtkhdf"},
}
OF_SECTION: Mapping[str, Mapping[str, Any]] = {
    "regularization": REGULARIZED, "solver": REGULARIZED, "series": SERIES, "pgd": PGD, "discontinuity": CUT,
    "near": NEAR, "volumes": VOLUME, "simulation": COMPARED, "identification": IDENTIFIED, "region": IDENTIFIED,
}
"""The case in which a section's keys are tried; PAIR where a section has none."""

RESULTS: Mapping[str, Mapping[str, Any]] = {"pair": PAIR, "series": SERIES, "pgd": PGD, "cut": CUT,
                                            "regularized": REGULARIZED, "volume": VOLUME}
"""Cases that are measured beforehand: their results are earlier.NAME.vtkhdf."""


def make_good_folder(folder: Path) -> Path:
    """Make the files of all good cases and measure some, unless they are there."""
    stamp, wanted = folder.with_suffix(".json"), json.dumps([source_version(), list(RESULTS)])
    if stamp.is_file() and stamp.read_text(encoding="utf-8") == wanted:
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    _write_images(folder)
    _write_mesh(folder)
    _write_volumes(folder)
    _measure(folder)
    stamp.write_text(wanted, encoding="utf-8")
    return folder


def _write_images(folder: Path) -> None:
    ddic("synth", "translation", "--vector", "1.3", "-0.7", *SMALL, "--noise", "1", "--output", str(folder))
    other = folder / "other"
    ddic("synth", "translation", "--vector", "2.6", "-1.4", *SMALL, "--noise", "1", "--output", str(other))
    (other / "deformed.tif").rename(folder / "deformed_2.tif")
    shutil.rmtree(other)
    ddic("synth", "near-far", *SMALL, "--ratio", "3", "--near-center", "60", "48", "--alpha", "0.7", "-0.2", "--output",
         str(other))
    for image in other.glob("*.tif"):
        image.rename(folder / image.name)
    shutil.rmtree(other)
    ddic("calibrate", str(folder / "far_reference.tif"), str(folder / "near_reference.tif"), "--ratio", "3", "--output",
         str(folder / "mapping.toml"))
    for name in ("reference", "deformed"):
        cv2.imwrite(str(folder / f"{name}.png"), tifffile.imread(folder / f"{name}.tif"))
    mask = np.full((SIDE, SIDE), 255, np.uint8)
    mask[:8, :8] = 0
    cv2.imwrite(str(folder / "mask.png"), mask)


def _write_mesh(folder: Path) -> None:
    """A mesh file of 4 x 4 quadrilaterals, a partition of it, and points to start from."""
    along = np.linspace(LOW, HIGH, 5)
    x, y = np.meshgrid(along, along)
    corner = (np.arange(4)[:, None] * 5 + np.arange(4)).ravel()
    quads = np.stack([corner, corner + 1, corner + 6, corner + 5], axis=1)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(25)], axis=1)
    tags = [np.zeros(len(quads), int)]
    mesh = meshio.Mesh(points, [("quad", quads)], cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags})
    mesh.write(folder / "mesh.msh", file_format="gmsh22", binary=False)
    moved = np.tile([1.3, -0.7, 0.0], (len(points), 1))
    meshio.Mesh(points, [("quad", quads)], {"U": moved}).write(folder / "simulated.vtu")
    (folder / "partition.txt").write_text("# of each cell\n" + "\n".join(str(k // 8) for k in range(16)) + "\n")
    (folder / "points.csv").write_text("x,y,u,v\n20,20,1.3,-0.7\n70,20,1.3,-0.7\n40,70,1.3,-0.7\n")
    (folder / "probes.toml").write_text("[point.A]\nat = [40, 40]\n")


def _write_volumes(folder: Path) -> None:
    """A pair of volumes with a mask, a mesh file of 4 x 4 x 1 boxes, a partition of it, and points to start from."""
    size = "x".join([str(VOLUME_SIDE)] * 3)
    other = folder / "other"
    ddic("synth", "translation", "--vector", "1.3", "-0.7", "0.4", "--size", size, "--seed", "3", "--noise", "1",
         "--output", str(other))
    for name in ("reference", "deformed"):
        (other / f"{name}.tif").rename(folder / f"volume_{name}.tif")
    shutil.copy(folder / "volume_deformed.tif", folder / "volume_deformed_2.tif")
    shutil.rmtree(other)
    mask = np.full((VOLUME_SIDE,) * 3, 255, np.uint8)
    mask[:2] = 0
    tifffile.imwrite(folder / "volume_mask.tif", mask)
    # As many cells as the mesh file of images has, so that partitions of both are alike.
    lines = np.linspace(BOX[0], BOX[3], 5)
    grid = GridLines((lines, lines, lines[[0, -1]])).build_mesh()
    write_mesh(folder / "volume_mesh.vtu", grid)
    (folder / "volume_partition.txt").write_bytes((folder / "partition.txt").read_bytes())
    (folder / "volume_points.csv").write_text("x,y,z,u,v,w\n" + "".join(
        f"{place},1.3,-0.7,0.4\n" for place in ("6,6,6", "26,6,8", "8,26,6", "6,8,26")))


def _measure(folder: Path) -> None:

    for name, case in RESULTS.items():
        case_file = folder / f"{name}.toml"
        case_file.write_text(write_toml({**case, "output": {"file": f"earlier.{name}.vtkhdf"}}), encoding="utf-8")
        ddic("run", str(case_file))
        case_file.unlink()
    for left in (*folder.glob("*.json"), *folder.glob("*.frames")):
        shutil.rmtree(left) if left.is_dir() else left.unlink()

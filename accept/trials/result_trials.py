"""Kinds of damaged results, dataset by dataset and attribute by attribute, for every command that reads one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from accept.trials.trial import CASE_FILE, PAIR, VOLUME, Trial, change

ODD = "odd.vtkhdf"
GRID = ("Points", "Types", "Offsets", "Connectivity", "NumberOfPoints", "NumberOfCells", "NumberOfConnectivityIds")
AT_NODES = ("displacement", "GlobalNodeId", "nodal_strain_hencky", "nodal_strain_infinitesimal",
            "nodal_von_mises_strain", "displacement_mesh_units")
ON_CELLS = ("GlobalCellId", "SubdomainId", "residual_rms", "residual_n_pixels", "excluded", "doubtful",
            "strain_infinitesimal", "equivalent_error")
OF_PAIR = (
    "VTKHDF", *(f"VTKHDF/{name}" for name in GRID), "VTKHDF/PointData",
    *(f"VTKHDF/PointData/{name}" for name in AT_NODES),
    "VTKHDF/CellData", *(f"VTKHDF/CellData/{name}" for name in ON_CELLS), "case", "units", "time", "provenance",
    "history", "history/gauss_newton", "history/gauss_newton/of_slow_nodes", "history/gauss_newton/residual_std_grey",
    "history/krylov", "history/krylov/0000", "history/phases", "history/phases/phase", "history/phases/seconds",
    "residual_image", "residual_image/residual",
)
OF_PGD = ("separated", "separated/amplitudes", "separated/nodes_x", "separated/nodes_y", "separated/x", "separated/y",
          "history/corrections", "history/corrections/correction", "history/corrections/sweeps")
OF_SERIES = ("VTKHDF/Steps", "VTKHDF/Steps/Values", "VTKHDF/Steps/PartOffsets", "VTKHDF/Steps/NumberOfParts",
             "VTKHDF/Steps/PointOffsets", "VTKHDF/Steps/CellOffsets", "VTKHDF/Steps/ConnectivityIdOffsets",
             "VTKHDF/Steps/PointDataOffsets", "VTKHDF/Steps/PointDataOffsets/displacement",
             "VTKHDF/Steps/CellDataOffsets/SubdomainId", "frames", "frames/000001", "frames/000001/case", "series",
             "series/records", "VTKHDF/PointData/displacement", "VTKHDF/Points", "VTKHDF/CellData/SubdomainId")
PLACES: Mapping[str, tuple[str, ...]] = {
    "pair": OF_PAIR, "pgd": OF_PGD, "series": OF_SERIES,
    "cut": ("VTKHDF/Points", "VTKHDF/PointData/displacement"),
    "regularized": ("history/krylov/0001", "VTKHDF/PointData/GlobalNodeId"),
    "volume": ("VTKHDF/Points", "VTKHDF/Types", "VTKHDF/Connectivity", "VTKHDF/PointData/displacement",
               "VTKHDF/PointData/nodal_strain_hencky", "residual_image/residual"),
}
"""Groups and datasets by the result that has them, which one after the other are damaged."""

ATTRIBUTES: Mapping[str, tuple[str, ...]] = {
    "pair": ("@y_axis", "@status", "@failure", "@ddic_schema", "case@json", "case@toml", "case@noise_floor_px",
             "case@eta", "case@path", "provenance@date", "provenance@reference_path", "provenance@reference_size",
             "provenance@n_ranks", "provenance@method", "time@deformed", "time@reference", "units@pixel_size",
             "units@length_unit", "residual_image@origin", "VTKHDF/PointData/displacement@axes"),
    "pgd": ("case@stop", "case@json"),
    "cut": ("case@json", "case@largest_jump_px"),
    "regularized": ("case@half_amplitude_shear_px", "case@json"),
    "series": ("series@numbers", "series@origin", "VTKHDF/Steps@NSteps", "frames/000001@failure",
               "frames/000001@status", "frames/000001/time@deformed", "frames/000001/case@json"),
}
"""Attributes, GROUP@NAME."""

LOOKS = ("info", "plot", "report", "export", "probe")
OPTIONS: Mapping[str, tuple[str, ...]] = {
    "plot": ("--output", "pictures"), "report": ("--output", "page.html"), "export": ("--csv", "table.csv"),
    "probe": ("--point", "40,40"),
}
OF_FRAME = ("--frame", "1")

Values = NDArray[Any]
DAMAGES: Mapping[str, Callable[[Values], Any]] = {
    "emptied": lambda old: old[:0],
    "made words": lambda old: ["a", "b"],
    "made as many words": lambda old: np.full(old.shape, b"word"),
    "made nan": lambda old: np.full_like(old, {"f": np.nan, "i": -1, "u": -1}[old.dtype.kind]),
    "halved": lambda old: old[:len(old) // 2],
    "made one number": lambda old: 1.0,
    "made one row longer": lambda old: np.concatenate([old, old[-1:]]),
    "made columns": lambda old: np.stack([old] * 2, axis=-1),
    "made rows of one": lambda old: old[:, None],
    "without its last dimension": lambda old: old[..., 0],
    "with a column less": lambda old: old[..., :-1],
    "made equal": lambda old: np.full_like(old, old.ravel()[0]),
    "made huge": lambda old: np.full_like(old, _find_largest(old.dtype)),
    "made complex": lambda old: old.astype(complex),
    "reversed": lambda old: old[::-1],
}
"""What becomes of a dataset."""

TEXTS: Mapping[str, Any] = {
    "words": "a b", "empty": "", "a number": 7, "nan": np.nan, "huge": 1e308, "an array": np.arange(3.0),
    "no numbers": np.zeros(0), "an empty object": "{}", "a list": "[1, 2]", "words of JSON": '{"mesh": "a", "near": 3}',
    "wrong lines": '{"discontinuity": [{"vertices": [[1]]}, 2]}', "deep": "[" * 3000, "bytes": np.void(b"\xff\x00"),
    "several lines": "a\nb\nc",
}
"""What becomes of an attribute."""


def list_result_trials() -> list[Trial]:
    """List damaged results."""
    return [*_list_datasets(), *_list_attributes(), *_list_points(), *_list_others()]


def _list_datasets() -> Iterator[Trial]:
    for name, places in PLACES.items():
        for place in places:
            is_group = "/" not in place or place in ("VTKHDF/PointData", "VTKHDF/CellData", "VTKHDF/Steps")
            kinds = ("removed", "emptied", "made words") if is_group else ("removed", *DAMAGES)
            for kind in kinds:
                yield _trial(f"{place} of a result ({name}) {kind}", name, partial(_damage, name, place, kind))


def _list_attributes() -> Iterator[Trial]:
    for name, places in ATTRIBUTES.items():
        for place in places:
            for kind in ("removed", *TEXTS):
                yield _trial(f"{place} of a result ({name}) {kind}", name,
                             partial(_damage_attribute, name, place, kind))


def _list_points() -> Iterator[Trial]:
    """Points that lie upon one another, a few of them: no cell has an area there, no triangulation takes them."""
    for name in ("pair", "cut", "series"):
        for kind, move in (("two points equal", _equal(2)), ("all points of one cell equal", _equal(7)),
                           ("all points on a line", _on_line)):
            yield _trial(f"a result ({name}) with {kind}", name, partial(_move_points, name, move))


def _list_others() -> Iterator[Trial]:
    """What is no result, and frames that are none."""
    for name, content in (("text", b"no"), ("empty", b""), ("HDF5's first bytes", b"\x89HDF\r\n\x1a\n")):
        yield Trial(f"start.from_result is {name}", change(PAIR, ("start", "from_result"), ODD),
                    (partial(_write, content),), expected="refused")
    for file in ("earlier.pair.residual.vtkhdf", "mask.png", "reference.tif", CASE_FILE):
        yield Trial(f"start.from_result = {file}", change(PAIR, ("start", "from_result"), file), expected="refused")
    of_frame = change(PAIR, ("start",), {"from_result": "earlier.series.vtkhdf", "frame": 9})
    yield Trial("start.frame that is none of the series", of_frame, expected="refused")


def _write(content: bytes, folder: Path) -> None:
    (folder / ODD).write_bytes(content)


def _find_largest(dtype: np.dtype[Any]) -> float | int:
    return float(np.finfo(dtype).max) if dtype.kind == "f" else np.iinfo(dtype).max


def _trial(title: str, name: str, edit: Callable[[Path], None]) -> Trial:
    start = {"from_result": ODD, **({"frame": 1} if name == "series" else {})}
    frame = OF_FRAME if name == "series" else ()
    options = {**OPTIONS, "probe": ("--point", "16,16,16")} if name == "volume" else OPTIONS
    looks = [(command, ODD, *options.get(command, ()), *(frame if command != "probe" else ())) for command in LOOKS]
    if name == "series":
        looks += [("info", ODD), ("plot", ODD, "--output", "curves")]
    if name == "cut":
        looks += [("opening", ODD), ("crack", ODD)]
    commands = (("check", CASE_FILE), ("run", CASE_FILE), *looks)
    case = VOLUME if name == "volume" else PAIR
    return Trial(title, change(case, ("start",), start), (edit,), commands, expected="refused or measured")


def _copy(name: str, folder: Path) -> Path:
    target = folder / ODD
    target.write_bytes((folder / f"earlier.{name}.vtkhdf").read_bytes())
    return target


def _damage(name: str, place: str, kind: str, folder: Path) -> None:
    with h5py.File(_copy(name, folder), "r+") as file:
        item = file[place]
        old = item[...] if isinstance(item, h5py.Dataset) else None
        said = dict(item.attrs)
        # What a dataset cannot become, a scalar without a row say, stays as it is.
        try:
            new = None if old is None or kind == "removed" else DAMAGES[kind](old)
        except (IndexError, KeyError, ValueError, TypeError):
            return
        del file[place]
        if kind == "removed":
            return
        if old is None:
            if kind == "emptied":
                file.create_group(place).attrs.update(said)
            else:
                file[place] = ["a", "b"]
            return
        file[place] = new
        file[place].attrs.update(said)


def _damage_attribute(name: str, place: str, kind: str, folder: Path) -> None:
    group, attribute = place.split("@")
    with h5py.File(_copy(name, folder), "r+") as file:
        attributes = file[group or "/"].attrs
        attributes.pop(attribute, None)
        if kind != "removed":
            attributes[attribute] = TEXTS[kind]


def _equal(n_points: int) -> Callable[[Values], Values]:
    return lambda points: np.concatenate([np.repeat(points[:1], n_points, axis=0), points[n_points:]])


def _on_line(points: Values) -> Values:
    return points * [1.0, 0.0, 0.0] + [0.0, 40.0, 0.0]


def _move_points(name: str, move: Callable[[Values], Values], folder: Path) -> None:
    with h5py.File(_copy(name, folder), "r+") as file:
        points = file["VTKHDF/Points"]
        points[...] = move(points[...])

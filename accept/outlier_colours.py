"""Colours of pictures when three cells of a field are far off: what becomes of those everywhere else."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.image import imread
from numpy.typing import NDArray

from accept.support.foam_noise import HOLES, REGION, foam_pairs
from accept.table import Scale
from bench.support.paper_case import name_images
from bench.support.rows import Row
from bench.support.runs import ddic, ddic_run, images, real_data
from ddic.io import result_schema as schema
from ddic.io.result_reader import Result, read_result
from ddic.plots import maps
from ddic.plots.canvas import COLOURS, DPI, PERCENTILES, PIXELS, ColourScale
from ddic.plots.maps import OPACITY

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

N_CELLS = 3
"""Of the stripe, side by side."""

TIMES = 100.0
"""Spans of a field's values by which those of the stripe lie above the largest."""

MOST_MOVED = 0.05
"""Of the span of the colours, by which outliers may move their ends."""

KINDS = ("displacement", "strain", "residual")

ALL = (0.0, 100.0)


@dataclass(frozen=True)
class Pictured:
    """One panel of ``ddic plot``, without outliers and with.

    Attributes
    ----------
    name : str
        What it shows.
    moved : float
        Farthest that an end of the colours moves, relative to their span.
    changed : float
        Mean change of the colours of all other cells, of 255.
    """

    name: str
    moved: float
    changed: float


def measure_colours(scale: Scale) -> list[Row]:
    """Draw results with and without a stripe of outliers, with the default percentiles and with all values."""
    if scale.smoke:
        return []
    folder = scale.folder("outlier_colours")
    return [_measure(name, case, folder) for name, case in list_cases(folder).items()]


def list_cases(folder: Path) -> dict[str, str]:
    """List the cases of five results, of some two thousand cells each."""
    plate = images("kirsch", "--size", "800x800", "--strain", "0.005", "--radius", "80", "--noise", "2", "--seed", "1",
                   folder=folder / "kirsch_images")
    waves = images("sinusoidal", "--size", "800x800", "--noise", "2", folder=folder / "sinusoidal_images")
    real, far = real_data(), foam_pairs()[0]
    hole = "circles = [{ center = [400, 400], radius = 90 }]"
    holes = ", ".join(f"{{ center = [{x}, {y}], radius = {r} }}" for x, y, r in HOLES)
    return {
        "kirsch": _describe(plate / "reference.tif", plate / "deformed.tif", (20, 20, 780, 780), 16, hole),
        "sinusoidal": _describe(waves / "reference.tif", waves / "deformed.tif", (20, 20, 780, 780), 16),
        "openhole": _describe(real / "openhole/zoom-0053_1.tif", real / "openhole/zoom-0070_1.tif",
                              (560, 20, 840, 1020), 12, "circles = [{ center = [696, 540], radius = 60 }]"),
        "fracture": _describe(real / "fracture/img_0030.png", real / "fracture/img_0060.png", (260, 60, 772, 1160), 16),
        "foam": _describe(far.reference, far.deformed, REGION, 8, f"circles = [{holes}]"),
    }


def _describe(reference: Path, deformed: Path, region: tuple[int, int, int, int], size: int, more: str = "") -> str:
    return (f"{name_images(reference, deformed)}[mesh.structured]\nregion = {list(region)}\nelement_size = {size}\n"
            f"{more}\n")


def _measure(name: str, case: str, folder: Path) -> Row:
    ddic_run(case, folder, 1, name)
    clean, spoilt = (folder / what / f"{name}.vtkhdf" for what in ("clean", "outliers"))
    for path in (clean, spoilt):
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(folder / f"{name}.vtkhdf", path)
    result = read_result(clean)
    stripe = find_stripe(result)
    set_outliers(spoilt, result, stripe)
    by_default = [panel for kind in KINDS for panel in _compare((clean, spoilt), stripe, kind, PERCENTILES)]
    by_all = _compare((clean, spoilt), stripe, "strain", ALL)
    moved = max(by_default, key=lambda panel: panel.moved)
    changed, of_all = (float(np.mean([panel.changed for panel in panels])) for panels in (by_default, by_all))
    most = _find_mean_change(MOST_MOVED)
    return Row(f"{name}, {result.mesh.n_cells} cells, default settings, of which a stripe of {N_CELLS} lies {TIMES:g} "
               f"spans above: ends of the colours of {len(by_default)} panels of ddic plot (displacement, strain, "
               "residual), and colours of all other cells but its neighbours",
               f"ends move by less than {MOST_MOVED:.0%} of their span; colours change on average by less than "
               f"what that makes, {most:.1f} of 255",
               f"ends by {moved.moved:.2%} at most ({moved.name}), colours by {changed:.2f} of 255; strain with "
               f"--percentiles 0 100: ends by {max(panel.moved for panel in by_all):.0%}, colours by {of_all:.0f}",
               moved.moved < MOST_MOVED and changed < most)


def find_stripe(result: Result) -> NDArray[np.int64]:
    """Find cells side by side, to the right of the lower third of the mesh's middle, where there are no holes."""
    mesh = result.mesh
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    begin = low + (high - low) * (0.45, 0.8)
    sides = np.ptp(mesh.nodes[mesh.get_cell(0)], axis=0)
    places = begin + np.arange(N_CELLS)[:, None] * (sides[0], 0.0)
    return np.array([int(np.linalg.norm(mesh.centroids - place, axis=1).argmin()) for place in places])


def set_outliers(path: Path, result: Result, stripe: NDArray[np.int64]) -> None:
    """Set the displacement and the strain at the nodes of some cells, and their residual, far above all others."""
    nodes = np.unique(np.concatenate([result.mesh.get_cell(cell) for cell in stripe]))
    with h5py.File(path, "r+") as file:
        at_nodes, on_cells = file["VTKHDF/PointData"], file["VTKHDF/CellData"]
        of_nodes = np.isin(at_nodes[schema.GLOBAL_NODE_ID][()], nodes)
        of_cells = np.isin(on_cells[schema.GLOBAL_CELL_ID][()], stripe)
        for data, name, rows in ((at_nodes, schema.DISPLACEMENT, of_nodes),
                                 (at_nodes, schema.NODAL_INFINITESIMAL, of_nodes),
                                 (on_cells, schema.RESIDUAL_RMS, of_cells)):
            values = data[name][()]
            values[rows] = np.nanmax(values) + TIMES * np.nanmax(np.ptp(_drop_nan(values), axis=0))
            data[name][...] = values


def _drop_nan(values: Array) -> Array:
    columns = values.reshape(len(values), -1)
    return np.asarray(columns[np.isfinite(columns).all(axis=1)])


def _compare(paths: tuple[Path, Path], stripe: NDArray[np.int64], kind: str,
             percentiles: tuple[float, float]) -> list[Pictured]:
    """Compare the panels of a picture of both results, cell by cell but for the stripe and its neighbours."""
    clean, spoilt = map(read_result, paths)
    before, after = (_draw(path, kind, percentiles) for path in paths)
    centres = clean.mesh.centroids[_find_others(clean, stripe)]
    scale = ColourScale(percentiles=percentiles)
    found = []
    names = [f"strain {number}" for number in ("xx", "yy", "xy")] if kind == "strain" else [kind]
    panels = zip(names, _list_panels(clean, kind), _list_panels(spoilt, kind), strict=True)
    for axes, (name, panel, moved) in zip(_list_axes(clean, kind), panels, strict=True):
        ends, moved_ends = np.array(scale.find_limits(panel.values)), np.array(scale.find_limits(moved.values))
        columns, rows = _find_pixels(axes, centres, len(before)).T
        found.append(Pictured(name, float(np.abs(moved_ends - ends).max() / np.ptp(ends)),
                              float(np.abs(after - before)[rows, columns].mean())))
    return found


def _find_others(result: Result, stripe: NDArray[np.int64]) -> BoolArray:
    """Tell which cells share no node with the stripe, (n_cells,), and have a value."""
    mesh = result.mesh
    is_of_stripe = np.zeros(len(mesh.nodes), dtype=bool)
    is_of_stripe[np.concatenate([mesh.get_cell(cell) for cell in stripe])] = True
    is_known = np.isfinite(result.displacement).all(axis=1)
    return np.array([is_known[mesh.get_cell(cell)].all() and not is_of_stripe[mesh.get_cell(cell)].any()
                     for cell in range(mesh.n_cells)])


def _draw(path: Path, kind: str, percentiles: tuple[float, float]) -> Array:
    """Draw a picture by the command line, (height, width, 3), from 0 to 255."""
    ddic("plot", str(path), "--kind", kind, "--percentiles", *map(str, percentiles))
    return np.asarray(255.0 * imread(path.with_suffix(f".{kind}.png"))[..., :3])


def _list_panels(result: Result, kind: str) -> list[maps.Values]:
    ways = {"displacement": lambda: maps.list_displacement_panels(result, "magnitude", PIXELS),
            "strain": lambda: maps.list_strain_panels(result, maps.StrainChoice()),
            "residual": lambda: maps.list_residual_panels(result)}
    return ways[kind]()


def _list_axes(result: Result, kind: str) -> list[Axes]:
    """List the axes of a picture's panels, whose scale is that of an image."""
    return [axes for axes in result.plot(kind).axes if axes.yaxis_inverted()]


def _find_pixels(axes: Axes, points: Array, height: int) -> NDArray[np.int64]:
    """Find the columns and rows of a picture at which points are drawn."""
    figure = axes.get_figure()
    assert figure is not None
    x, y = (axes.transData.transform(points) * DPI / figure.dpi).T
    return np.asarray(np.rint(np.column_stack([x, height - y]) - 0.5), dtype=np.int64)


def _find_mean_change(moved: float) -> float:
    """Mean change of colours, over an image, that move by a share of their span, of 255."""
    along = np.linspace(0.0, 1.0 - moved, 256)
    change = colormaps[COLOURS](along + moved) - colormaps[COLOURS](along)
    return float(255.0 * OPACITY * np.abs(change[:, :3]).mean())

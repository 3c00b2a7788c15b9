"""Pictures of five kinds of case: none is clipped, no drawn cell folds, and they come as PNG, PDF and SVG."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

import ddic
from accept.report_page import find_clipped_texts
from accept.table import Scale
from bench.support import runs
from bench.support.rows import Row
from bench.support.runs import ROOT, ddic_command, images, mpirun
from ddic.io.image_file import open_image
from ddic.io.result_reader import Result, read_result
from ddic.io.result_schema import CAMERA
from ddic.kinematics.strain import count_folded_cells
from ddic.plots.canvas import PIXELS, Preview, find_length_unit
from ddic.plots.curves import draw_krylov
from ddic.plots.maps import (
    StrainChoice,
    draw_deformed,
    draw_displacement,
    draw_near_far,
    draw_residual,
    draw_strain,
    find_shared_view,
    read_preview,
)
from ddic.plots.partition import draw_partition

Array = NDArray[np.float64]

SLIP = 1.5
"""Pixels that each side of the line moves along it."""


def measure_pictures(scale: Scale) -> list[Row]:
    """Draw all pictures of five cases."""
    folder = scale.folder("impressions") / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    cases = {"plate": _measure_plate(folder), "turned strip in mm": _measure_strip(folder),
             "line": _measure_line(folder), "PGD": _measure_separated(folder)}
    if not scale.smoke:
        cases["near and far"] = _measure_near_far(folder)
    n_figures, clipped, folded = 0, [], []
    for name, (result, image) in cases.items():
        drawn = _draw(result, image)
        n_figures += len(drawn)
        clipped += [f"{name}, {kind}: {text}" for kind, figure in drawn.items() for text in find_clipped_texts(figure)]
        n_folded = count_folded_cells(result.mesh, _find_drawn_nodes(result, drawn["deformed"]))
        if n_folded:
            folded.append(f"{name}: {n_folded} at {find_shared_view([result], None, PIXELS).factor:g} times")
    return [Row(f"{n_figures} pictures of {len(cases)} cases ({', '.join(cases)}): texts that the page's edge cuts",
                "none", "; ".join(clipped) or "none", not clipped),
            Row("cells of the deformed meshes that fold at the amplification that is chosen", "none",
                "; ".join(folded) or "none", not folded),
            _measure_formats(folder / "plate.vtkhdf")]


Case = tuple[Result, Preview]
"""A result and its reference image."""


Pair = tuple[NDArray[Any], NDArray[Any]]


def _measure(path: Path, pair: Pair, mesh: ddic.Mesh, options: Mapping[str, Any]) -> Case:
    ddic.measure(pair, mesh, **options, output=str(path))
    height, width = pair[0].shape
    return read_result(path), Preview(pair[0], 1, width, height)


def _measure_plate(folder: Path) -> Case:
    side = 240
    kirsch = images("kirsch", "--size", f"{side}x{side}", "--strain", "0.005", "--radius", "30", "--noise", "2",
                    folder=folder / "images")
    pair = [open_image(kirsch / f"{name}.tif") for name in ("reference", "deformed")]
    mesh = ddic.structured_mesh((12, 12, 228, 228), 9, circles=[((119.5, 119.5), 30)])
    preview = read_preview(pair[0])
    pixels = (preview.pixels, read_preview(pair[1]).pixels)
    return _measure(folder / "plate.vtkhdf", pixels, mesh, {"regularization": {"cut_off_wavelength": 40},
                                                    "solver": {"method": "dual", "subdomains": 9}})


def _measure_strip(folder: Path) -> Case:
    middle, turn = np.array([70.0, 250.0]), 0.05
    c, s = np.cos(turn), np.sin(turn)

    def stretch_and_turn(points: Array) -> Array:
        away = points - middle
        return np.asarray((away * [0.997, 1.01]) @ np.array([[c, s], [-s, c]]) + middle + [3.0, -2.0] - points)

    pair = ddic.make_synthetic_pair(stretch_and_turn, (140, 500), noise=1, seed=5)
    mesh = ddic.structured_mesh((16, 30, 124, 470), 12, circles=[((70, 250), 25)])
    path = folder / "a_strip_with_a_name_that_is_longer_than_any_title_should_be.vtkhdf"
    return _measure(path, pair, mesh,
                    {"images": {"pixel_size": 0.0125, "length_unit": "mm"},
                     "solver": {"method": "dual", "subdomains": 12}, "regularization": {"cut_off_wavelength": 50}})


def _measure_line(folder: Path) -> Case:
    start, along = np.array([-20.0, 62.3]), np.array([np.cos(0.37), np.sin(0.37)])
    across = np.array([-along[1], along[0]])

    def slide(points: Array) -> Array:
        height = (points - start) @ across
        return np.asarray((0.4 + np.where(height > 0, SLIP, -SLIP) + 1e-3 * height)[:, None] * along)

    pair = ddic.make_synthetic_pair(slide, (400, 200), noise=1, seed=3)
    line = {"vertices": [start.tolist(), (start + 500 * along).tolist()]}
    return _measure(folder / "line.vtkhdf", pair, ddic.structured_mesh((20, 20, 380, 180), 16),
                    {"discontinuity": [line], "solver": {"method": "dual", "subdomains": 4}})


def _measure_separated(folder: Path) -> Case:
    def wave(points: Array) -> Array:
        return np.column_stack([0.5 * np.sin(points[:, 0] / 90), 0.4 * np.cos(points[:, 1] / 40)])

    pair = ddic.make_synthetic_pair(wave, (600, 100), noise=1, seed=7)
    return _measure(folder / "separated.vtkhdf", pair, ddic.structured_mesh((10, 10, 590, 90), 4),
                    {"pgd": {}, "regularization": {"cut_off_wavelength": 40}})


def _measure_near_far(folder: Path) -> Case:
    case = folder / "near_far"
    images("near-far", "--size", "400x320", "--ratio", "4", "--radius", "40", "--noise", "2", "--seed", "2",
           folder=case / "images")
    far, near = (str(case / "images" / f"{name}_reference.tif") for name in ("far", "near"))
    # No command replaces what a case names, such as that of an earlier run.
    (case / "mapping.toml").unlink(missing_ok=True)
    runs.ddic("calibrate", far, near, "--ratio", "4.2", "--model", "similarity", "--output", str(case / "mapping.toml"))
    text = (ROOT / "examples" / "near_far" / "case.toml").read_text(encoding="utf-8")
    (case / "case.toml").write_text(text, encoding="utf-8")
    mpirun(2, ddic_command(), "run", str(case / "case.toml"))
    return read_result(case / "result.vtkhdf"), read_preview(open_image(case / "images" / "far_reference.tif"))


def _draw(result: Result, image: Preview) -> dict[str, Figure]:
    unit = find_length_unit(result)
    figures = {
        "partition": draw_partition(result, image, unit),
        "deformed": draw_deformed(result, unit=unit),
        "displacement": draw_displacement(result, image, "y", unit),
        "strain": draw_strain(result, StrainChoice(), image, unit),
        "von Mises": draw_strain(result, StrainChoice("hencky", "von-mises"), image, unit),
        "residual": draw_residual(result, unit=unit),
        "signed residual": draw_residual(result, signed=True, unit=unit),
    }
    if any(len(history) for history in result.krylov):
        figures["krylov"] = draw_krylov({result.path.name: result.krylov, "other": result.krylov})
    if CAMERA in result.cell_data:
        figures["near-far"] = draw_near_far(result, "y", unit)
    return figures


def _find_drawn_nodes(result: Result, figure: Figure) -> Array:
    """Where the picture of the deformed mesh has the nodes, from the outlines of its cells."""
    outlines = [c for c in figure.axes[0].collections if isinstance(c, PolyCollection)][-1].get_paths()
    nodes = np.full(result.mesh.nodes.shape, np.nan)
    for cell, outline in zip(result.mesh.cells, outlines, strict=True):
        corners = cell[cell >= 0]
        nodes[corners] = np.asarray(outline.vertices)[:len(corners)]
    return nodes


def _measure_formats(path: Path) -> Row:
    begins = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}
    found = {}
    for ending, begin in begins.items():
        runs.ddic("plot", str(path), "--kind", "strain", "--strain", "yy", "--limits", "0", "0.015", "--format", ending,
                  "--dpi", "300")
        written = path.with_name(f"{path.stem}.strain_yy.{ending}").read_bytes()
        found[ending] = written.startswith(begin) and b"/Type3" not in written
    return Row("one strain at 300 dpi, with limits, as PNG, PDF and SVG", "written; no Type 3 font",
               ", ".join(f"{ending} {'yes' if good else 'no'}" for ending, good in found.items()), all(found.values()))

"""What the preconditioner brings: GMRES iterations at equal displacement error, four-point-bending-like case.

The open-hole beam of [BP17, 5.3] scaled to 1500 x 1000 px: mixed T3/Q4 mesh of 15 px, 45 METIS subdomains,
equilibrium gap.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from accept.support.beam_mesh import write_beam_mesh
from accept.table import Scale
from bench.support.rows import RESULTS, Row, append_result
from bench.support.runs import ROOT, images, run_job


@dataclass(frozen=True)
class Beam:
    """Size of the case.

    Attributes
    ----------
    width, height : int
        Of the images, pixels.
    margin : int
        Edge without elements, pixels.
    radius : int
        Of the hole in the middle, pixels.
    subdomains : int
        Their number.
    """

    width: int
    height: int
    margin: int
    radius: int
    subdomains: int


FULL, SMOKE = Beam(1500, 1000, 50, 120, 45), Beam(300, 240, 30, 30, 6)
ELEMENT = 15
"""Side of the elements, pixels."""

WAVELENGTH = 150
"""Cut-off wavelength, pixels."""

TARGET = 1e-4
"""Relative displacement error at which iterations are compared."""

LEAST_RATIO = 10
"""Times fewer iterations than without a preconditioner."""

NAMES = {"none": "no preconditioner", "paper": "block explicit inverse [BP17]", "scaled": "scaled block inverse"}


def measure(scale: Scale) -> list[Row]:
    """Count iterations after which the displacement is within 1e-4 of the monolithic one, and draw the curves.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a small beam.

    Returns
    -------
    list of Row
        One row.
    """
    beam = SMOKE if scale.smoke else FULL
    lines = run_job(1, "accept.support.preconditioner_job", json.dumps(_case(beam, scale.folder("beam"))))
    records = {record["preconditioner"]: record for record in lines}
    needed = {kind: _count_iterations(record["curve"]) for kind, record in records.items()}
    for kind, record in records.items():
        append_result("preconditioners_runs", {**{k: v for k, v in record.items() if k != "curve"},
                                               "cut_off_wavelength": WAVELENGTH, "iterations": needed[kind]})
    picture = RESULTS / ("preconditioners_smoke.png" if scale.smoke else "preconditioners.png")
    _draw(records).savefig(picture, dpi=150)
    ratio = needed["none"] / needed["scaled"]
    return [Row(f"preconditioned against plain GMRES, four-point-bending-like case, {beam.width} x {beam.height} px, "
                f"{records['scaled']['n_dofs']} unknowns, {beam.subdomains} subdomains, l_c = {WAVELENGTH} px, to an "
                f"error of {TARGET:.0e}", f"at least {LEAST_RATIO} times fewer iterations; curves drawn",
                f"plain {needed['none']}, scaled {needed['scaled']} ({ratio:.1f} times fewer), paper's "
                f"{needed['paper']}; {picture.relative_to(ROOT)}", ratio >= LEAST_RATIO,
                judged_small=False)]


def _case(beam: Beam, folder: Path) -> dict[str, Any]:
    """Make images and mesh; returns the sections of the case."""
    images("bending", "--size", f"{beam.width}x{beam.height}", "--noise", "2", "--curvature", "2e-5", folder=folder)
    region = (beam.margin, beam.margin, beam.width - beam.margin, beam.height - beam.margin)
    write_beam_mesh(folder / "beam.vtk", region, ELEMENT, ((beam.width / 2, beam.height / 2), beam.radius))
    return {
        "images": {"reference": f"{folder}/reference.tif", "deformed": f"{folder}/deformed.tif"},
        "mesh": {"file": f"{folder}/beam.vtk"},
        "regularization": {"cut_off_wavelength": WAVELENGTH},
        "solver": {"method": "dual", "subdomains": beam.subdomains},
    }


def _count_iterations(curve: list[tuple[int, float, float]]) -> int:
    """Iterations from which on the error stays within TARGET."""
    above = [iteration for iteration, _, error in curve if error > TARGET]
    return (max(above) if above else -1) + 1


def _draw(records: dict[str, Any]) -> Figure:
    """Displacement error over iterations."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    for kind, record in records.items():
        axes.semilogy([p[0] for p in record["curve"]], [p[2] for p in record["curve"]], label=NAMES[kind])
    axes.axhline(TARGET, color="0.5", linewidth=0.8, linestyle="--")
    axes.set_xlabel("GMRES iteration")
    axes.set_ylabel("displacement error against monolithic")
    axes.set_title("Open-hole beam in bending")
    axes.legend()
    axes.grid(alpha=0.3)
    return figure

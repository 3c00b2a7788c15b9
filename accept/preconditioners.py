"""What the preconditioner brings: GMRES iterations at equal displacement error, four-point-bending-like case.

The open-hole beam of [BP17, 5.3] scaled to 1500 x 1000 px: mixed T3/Q4 mesh of 15 px, 45 METIS subdomains,
equilibrium gap. As python -m accept.preconditioners CASE, a JSON object with the sections of a case, it prints error
and residual after every GMRES iteration, a JSON line for each preconditioner.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from matplotlib.figure import Figure

from accept.table import Scale
from bench.support.first_step import count_iterations, find_error_curve, prepare_first_step
from bench.support.rows import RESULTS, Row, append_result
from bench.support.runs import ROOT, images, run_job
from ddic.case.schema import Case
from ddic.mesh.cell_type import Q4, T3
from ddic.mesh.structured import build_structured_mesh
from ddic.mesh.topology import find_boundary_nodes
from ddic.solvers.dual.dual_step import DualSettings
from ddic.solvers.dual.preconditioner import Preconditioner


def write_beam_mesh(path: Path, region: tuple[float, float, float, float], element_size: float,
                    hole: tuple[tuple[float, float], float], seed: int = 0) -> None:
    """Write a mesh whose inner nodes are moved at random and of whose quadrangles two in five are cut in two."""
    mesh = build_structured_mesh(region, element_size, "Q4", [hole], [], None)
    rng = np.random.default_rng(seed)
    moved = rng.uniform(-0.18, 0.18, size=mesh.nodes.shape) * element_size
    moved[find_boundary_nodes(mesh)] = 0.0
    quads = mesh.cells[mesh.types == Q4.vtk]
    triangles = mesh.cells[mesh.types == T3.vtk][:, :3]
    cut = rng.random(len(quads)) < 0.4
    halves = np.concatenate([quads[cut][:, [0, 1, 2]], quads[cut][:, [0, 2, 3]]])
    cells = [("quad", quads[~cut]), ("triangle", np.concatenate([triangles, halves]))]
    points = np.pad(mesh.nodes + moved, ((0, 0), (0, 1)))
    meshio.write(path, meshio.Mesh(points, cells), file_format="vtk")


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
    """Count iterations after which the displacement is within 1e-4 of the monolithic one, and draw the curves."""
    beam = SMOKE if scale.smoke else FULL
    lines = run_job(1, "accept.preconditioners", json.dumps(_case(beam, scale.folder("beam"))))
    records = {record["preconditioner"]: record for record in lines}
    needed = {kind: count_iterations(record["curve"], TARGET) for kind, record in records.items()}
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


KINDS: tuple[Preconditioner, ...] = ("none", "paper", "scaled")
TOLERANCE, MOST_ITERATIONS = 1e-8, 3000
"""Of GMRES."""


def main(case_json: str) -> None:
    """Print a curve for each preconditioner."""
    case = Case.model_validate(json.loads(case_json))
    first = prepare_first_step(case)
    region = first.problem.region
    for kind in KINDS:
        curve, n_interface = find_error_curve(first, DualSettings(kind, TOLERANCE, MOST_ITERATIONS))
        print(json.dumps({"preconditioner": kind, "n_dofs": region.n_field, "n_interface": n_interface,
                          "subdomains": region.n_subdomains, "curve": curve}), flush=True)
    first.destroy()


if __name__ == "__main__":
    main(sys.argv[1])

"""What the preconditioner brings: GMRES iterations at equal displacement error, four-point-bending-like case.

The open-hole beam of [BP17, 5.3] scaled to 1500 x 1000 px: mixed T3/Q4 mesh of 15 px, 45 METIS subdomains,
equilibrium gap.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from bench.support.beam_mesh import write_beam_mesh
from bench.support.rows import RESULTS, Row, append_result, main
from bench.support.runs import DATA, ROOT, images
from matplotlib.figure import Figure

JOB = Path(__file__).parent / "support" / "preconditioner_job.py"
WAVELENGTH = 150
TARGET = 1e-4
NAMES = {"none": "no preconditioner", "paper": "block explicit inverse [BP17]", "scaled": "scaled block inverse"}


def measure() -> list[Row]:
    """Iterations after which the displacement is within 1e-4 of the monolithic one, and both curves drawn."""
    folder = images("bending", "--size", "1500x1000", "--noise", "2", "--curvature", "2e-5", folder=DATA / "beam")
    write_beam_mesh(folder / "beam.vtk", (50, 50, 1450, 950), 15, ((750, 500), 120))
    case = {
        "images": {"reference": f"{folder}/reference.tif", "deformed": f"{folder}/deformed.tif"},
        "mesh": {"file": f"{folder}/beam.vtk"},
        "regularization": {"cut_off_wavelength": WAVELENGTH},
        "solver": {"subdomains": 45},
    }
    done = subprocess.run([sys.executable, str(JOB), json.dumps(case)], cwd=ROOT, check=True, text=True,
                          capture_output=True)
    records = {r["preconditioner"]: r for r in map(json.loads, done.stdout.splitlines())}
    needed = {kind: _iterations(record["curve"]) for kind, record in records.items()}
    for kind, record in records.items():
        append_result("preconditioners_runs", {**{k: v for k, v in record.items() if k != "curve"},
                                               "cut_off_wavelength": WAVELENGTH, "iterations": needed[kind]})
    picture = RESULTS / "preconditioners.png"
    _draw(records).savefig(picture, dpi=150)
    ratio = needed["none"] / needed["scaled"]
    sizes = records["scaled"]
    return [Row(f"preconditioned against plain GMRES, four-point-bending-like case, 1500 x 1000 px, "
                f"{sizes['n_dofs']} unknowns, 45 subdomains, l_c = {WAVELENGTH} px, to an error of {TARGET:.0e}",
                "at least 10 times fewer iterations; curves drawn",
                f"plain {needed['none']}, scaled {needed['scaled']} ({ratio:.1f} times fewer), paper's "
                f"{needed['paper']}; {picture.relative_to(ROOT)}", ratio >= 10)]


def _iterations(curve: list[tuple[int, float, float]]) -> int:
    above = [iteration for iteration, _, error in curve if error > TARGET]
    return (max(above) if above else -1) + 1


def _draw(records: dict[str, Any]) -> Figure:
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    for kind, record in records.items():
        axes.semilogy([p[0] for p in record["curve"]], [p[2] for p in record["curve"]], label=NAMES[kind])
    axes.axhline(TARGET, color="0.5", linewidth=0.8, linestyle="--")
    axes.set_xlabel("GMRES iteration")
    axes.set_ylabel("displacement error against monolithic")
    axes.set_title("Open-hole beam in bending, 45 subdomains")
    axes.legend()
    axes.grid(alpha=0.3)
    return figure


if __name__ == "__main__":
    main("preconditioners", measure)

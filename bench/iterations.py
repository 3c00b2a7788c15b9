"""GMRES iterations of the interface problem over the grid l_c/H x number of subdomains, METIS partitions.

Usage: iterations.py [ELEMENTS_PER_SIDE ...] [--sides N ...]; all of the grid by default. One JSON line
per cell and preconditioner goes to bench/results/iterations.jsonl, a picture beside it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from support.harness import DATA, RESULTS, ROOT, append_result, images

JOB = Path(__file__).parent / "support" / "iterations_job.py"
CELL = 8
RATIOS = (0.5, 1, 2, 4, 8, 16, 32)
SIDES = (2, 4, 8, 16)


def cell(elements: int, side: int, ratio: float) -> list[dict[str, Any]]:
    """All preconditioners on one cell of the grid; H is the side of a subdomain of elements x elements."""
    n = elements * side
    size = n * CELL + 64
    folder = images("sinusoidal", "--size", f"{size}x{size}", "--noise", "2", folder=DATA / f"iterations_{n}")
    case = {
        "images": {"reference": f"{folder}/reference.tif", "deformed": f"{folder}/deformed.tif"},
        "mesh": {"structured": {"region": [32, 32, 32 + n * CELL, 32 + n * CELL], "element_size": CELL}},
        "regularization": {"cut_off_wavelength": ratio * elements * CELL},
        "solver": {"subdomains": side**2},
    }
    done = subprocess.run([sys.executable, str(JOB), json.dumps(case)], cwd=ROOT, check=True, text=True,
                          capture_output=True)
    found = []
    for line in done.stdout.splitlines():
        record = {"lc_over_H": ratio, "n_subdomains": side**2, "elements_per_side": elements, **json.loads(line)}
        append_result("iterations", record)
        found.append(record)
    return found


def measure(elements: list[int], sides: list[int]) -> list[dict[str, Any]]:
    """The whole grid, a line of text per cell as it is measured."""
    records = []
    for side_elements in elements:
        for side in sides:
            for ratio in RATIOS:
                found = cell(side_elements, side, ratio)
                records += found
                counts = ", ".join(f"{r['preconditioner']} {r['iterations']} ({r['relative_difference']:.0e})"
                                   for r in found)
                print(f"{side_elements} x {side_elements} elements, {side**2:3d} subdomains, l_c/H = {ratio:4}: "
                      f"{counts}; floor {found[0]['rounding_floor']:.0e}", flush=True)
    return records


def draw(records: list[dict[str, Any]]) -> Figure:
    """Iterations of the two-level preconditioner over l_c/H, a line per number of subdomains."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    panels = sorted({r["elements_per_side"] for r in records})
    for axes, elements in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        for kind, style in (("two_level", "-"), ("scaled", ":")):
            for colour, count in enumerate(sorted({r["n_subdomains"] for r in records})):
                chosen = [r for r in records if (r["preconditioner"], r["n_subdomains"], r["elements_per_side"])
                          == (kind, count, elements)]
                axes.loglog([r["lc_over_H"] for r in chosen], [r["iterations"] for r in chosen], style,
                            color=f"C{colour}", marker=".", label=f"{count}, {kind.replace('_', '-')}")
        axes.set_title(f"subdomains of {elements} x {elements} elements")
        axes.set_xlabel("l_c / H")
        axes.set_ylabel("GMRES iterations to 1e-6")
        axes.legend(fontsize="x-small", title="subdomains")
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("elements", nargs="*", type=int, default=[10, 20])
    parser.add_argument("--sides", nargs="*", type=int, default=list(SIDES))
    arguments = parser.parse_args()
    records = measure(arguments.elements, arguments.sides)
    RESULTS.mkdir(parents=True, exist_ok=True)
    draw(records).savefig(RESULTS / "iterations.png", dpi=150)


if __name__ == "__main__":
    main()

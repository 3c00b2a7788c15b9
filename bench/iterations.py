"""GMRES iterations of the interface problem: a grid l_c/H x number of subdomains, low contrast, a mixed mesh.

Usage: python -m bench.iterations [ELEMENTS_PER_SIDE ...] [--sides N ...] [--kinds KIND ...] [--jobs N]; everything by
default, which takes a quarter of an hour on two cores. One JSON line per cell and preconditioner goes to
bench/results/iterations.jsonl, started afresh by every full run, with a picture beside it; a run of a part
of it goes to iterations_part.jsonl, also afresh. An "iterations" of null means more than "more_than".
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from bench.support.rows import RESULTS, append_result
from bench.support.runs import DATA, ROOT, environment, images
from bench.support.unstructured_mesh import write_unstructured_mesh

JOB = "bench.support.iterations_job"
CELL = 8
RATIOS = (0.5, 1, 2, 4, 8, 16, 32)
SIDES = (2, 4, 8, 16)
ELEMENTS = (10, 20)
KINDS = ("two_level", "scaled", "paper", "none")
LARGEST_FOR_PLAIN = 64
"""Subdomains up to which the paper's preconditioner and plain GMRES are run on the grid: beyond they only take time."""
CONTRAST, CONTRAST_RATIO = 0.1, 4
MIXED_RATIOS = (1, 8)
MIXED_ELEMENT = 8.0
"""Side of the elements of the mixed mesh, pixels."""


@dataclass(frozen=True)
class Plate:
    """A plate with a hole in its middle, of triangles and quadrangles.

    Attributes
    ----------
    width, height : int
        Of the images, pixels.
    radius : float
        Of the hole, pixels.
    subdomains : int
        Their number.
    """

    width: int
    height: int
    radius: float
    subdomains: int


PLATE, SMALL_PLATE = Plate(1500, 1000, 120.0, 180), Plate(250, 220, 20.0, 6)


@dataclass(frozen=True)
class Task:
    """One partitioned mesh for one process, which runs all ratios on it.

    name: "grid", "contrast" (grad f CONTRAST times as large in every second subdomain) or "mixed"; case: of ddic;
    size: H, the side of a subdomain, px; elements: along H; cost: relative, to start the long ones first.
    """

    name: str
    case: dict[str, Any]
    ratios: tuple[float, ...]
    kinds: tuple[str, ...]
    size: float
    elements: float
    cost: float


def grid_tasks(elements: Sequence[int], sides: Sequence[int], kinds: Sequence[str],
               ratios: Sequence[float] = RATIOS) -> list[Task]:
    """List the grid l_c/H x number of subdomains.

    Parameters
    ----------
    elements : sequence of int
        Elements along the side of a subdomain.
    sides : sequence of int
        Subdomains along the side of the region.
    kinds : sequence of str
        Preconditioners.
    ratios : sequence of float
        l_c/H.

    Returns
    -------
    list of Task
        One for each partitioned mesh.
    """
    return [_square("grid", n, side, tuple(ratios), kinds) for n in elements for side in sides]


def contrast_tasks(elements: Sequence[int], sides: Sequence[int], kinds: Sequence[str]) -> list[Task]:
    """List the same at one l_c/H with the texture's contrast ten times lower in every second subdomain.

    Parameters
    ----------
    elements : sequence of int
        Elements along the side of a subdomain.
    sides : sequence of int
        Subdomains along the side of the region.
    kinds : sequence of str
        Preconditioners.

    Returns
    -------
    list of Task
        One for each partitioned mesh.
    """
    return [_square("contrast", n, side, (CONTRAST_RATIO,), kinds) for n in elements for side in sides]


def mixed_tasks(kinds: Sequence[str], plate: Plate = PLATE) -> list[Task]:
    """List an unstructured mesh of triangles and quadrangles with a hole.

    Parameters
    ----------
    kinds : sequence of str
        Preconditioners.
    plate : Plate
        Its size.

    Returns
    -------
    list of Task
        One.
    """
    folder = images("bending", "--size", f"{plate.width}x{plate.height}", "--noise", "2", "--curvature", "2e-5",
                    folder=DATA / f"iterations_mixed_{plate.width}")
    region = (50.0, 50.0, plate.width - 50.0, plate.height - 50.0)
    hole = ((plate.width / 2, plate.height / 2), plate.radius)
    n_cells, area = write_unstructured_mesh(folder / "mesh.vtk", region, MIXED_ELEMENT, hole)
    case = {**_images(folder), "mesh": {"file": f"{folder}/mesh.vtk"},
            "solver": {"method": "dual", "subdomains": plate.subdomains}}
    side = (area / plate.subdomains) ** 0.5
    return [Task("mixed", case, MIXED_RATIOS, tuple(kinds), side, round((n_cells / plate.subdomains) ** 0.5, 1),
                 n_cells)]


def _square(name: str, elements: int, side: int, ratios: tuple[float, ...], kinds: Sequence[str]) -> Task:
    n = elements * side
    size = n * CELL + 64
    folder = images("sinusoidal", "--size", f"{size}x{size}", "--noise", "2", folder=DATA / f"iterations_{n}")
    region = [32, 32, 32 + n * CELL, 32 + n * CELL]
    case = {**_images(folder), "mesh": {"structured": {"region": region, "element_size": CELL}},
            "solver": {"method": "dual", "subdomains": side**2}}
    chosen = tuple(k for k in kinds if side**2 <= LARGEST_FOR_PLAIN or k not in ("paper", "none"))
    return Task(name, case, ratios, chosen, elements * CELL, elements, n**2 * len(ratios))


def _images(folder: Path) -> dict[str, Any]:
    # The wavelength is a placeholder: the job gives its own, but mesh and partition need a regularized case.
    return {"images": {"reference": f"{folder}/reference.tif", "deformed": f"{folder}/deformed.tif"},
            "regularization": {"cut_off_wavelength": CELL}}


def run(task: Task) -> list[dict[str, Any]]:
    """All ratios and preconditioners of a task in one process; a record each."""
    argument = {"case": task.case, "wavelengths": [ratio * task.size for ratio in task.ratios], "kinds": task.kinds,
                "dim": CONTRAST if task.name == "contrast" else 1.0}
    done = subprocess.run([sys.executable, "-m", JOB, json.dumps(argument)], cwd=ROOT, env=environment(), check=False,
                          text=True, capture_output=True)
    if done.returncode != 0:
        raise RuntimeError(f"{JOB} ended with {done.returncode}:\n{done.stderr[-4000:]}")
    ratio_of = {ratio * task.size: ratio for ratio in task.ratios}
    return [{"case": task.name, "lc_over_H": ratio_of[record["cut_off_wavelength"]],
             "n_subdomains": task.case["solver"]["subdomains"], "elements_per_side": task.elements, **record}
            for record in map(json.loads, done.stdout.splitlines())]


def measure(tasks: Sequence[Task], n_jobs: int,
            report: Callable[[list[dict[str, Any]]], None]) -> list[dict[str, Any]]:
    """Run all tasks, the longest first, ``n_jobs`` at a time; ``report`` gets a task's records as it ends."""
    records: list[dict[str, Any]] = []
    with ThreadPoolExecutor(n_jobs) as pool:
        running = [pool.submit(run, task) for task in sorted(tasks, key=lambda t: -t.cost)]
        for future in as_completed(running):
            report(future.result())
            records += future.result()
    return records


def lines(records: Sequence[dict[str, Any]]) -> Iterator[str]:
    """A line of text per cell."""
    def place(r: dict[str, Any]) -> tuple[str, float, int, float]:
        return str(r["case"]), r["elements_per_side"], r["n_subdomains"], r["lc_over_H"]

    for name, elements, count, ratio in sorted({place(r) for r in records}):
        found = [r for r in records if place(r) == (name, elements, count, ratio)]
        counts = ", ".join(f"{r['preconditioner']} {_count(r)}" for r in found)
        yield (f"{name}: {elements} x {elements} elements, {count:3d} subdomains, l_c/H = {ratio:4}: {counts}; "
               f"floor {found[0]['rounding_floor']:.0e}")


def _count(record: dict[str, Any]) -> str:
    if record["iterations"] is None:
        return f"> {record['more_than']}"
    errors = [f"{record[key]:.0e} at {tolerance}" for key, tolerance
              in (("difference_at_1e-6", "1e-6"), ("relative_difference", "1e-10")) if record[key] is not None]
    return f"{record['iterations']} (error {', '.join(errors)})"


def draw(records: Sequence[dict[str, Any]]) -> Figure:
    """Iterations of the two-level preconditioner over l_c/H on the grid, a line per number of subdomains."""
    grid = [r for r in records if r["case"] == "grid" and r["iterations"] is not None]
    figure = Figure(figsize=(9, 4), layout="constrained")
    panels = sorted({r["elements_per_side"] for r in grid})
    for axes, elements in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        for kind, style in (("two_level", "-"), ("scaled", ":")):
            for colour, count in enumerate(sorted({r["n_subdomains"] for r in grid})):
                chosen = sorted((r["lc_over_H"], r["iterations"]) for r in grid
                                if (r["preconditioner"], r["n_subdomains"], r["elements_per_side"])
                                == (kind, count, elements))
                axes.loglog([c[0] for c in chosen], [c[1] for c in chosen], style,
                            color=f"C{colour}", marker=".", label=f"{count}, {kind.replace('_', '-')}")
        axes.set_title(f"subdomains of {elements} x {elements} elements")
        axes.set_xlabel("l_c / H")
        axes.set_ylabel("GMRES iterations to 1e-6")
        axes.legend(fontsize="x-small", title="subdomains")
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("elements", nargs="*", type=int, default=list(ELEMENTS))
    parser.add_argument("--sides", nargs="+", type=int, default=list(SIDES))
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    chosen = parser.parse_args()
    full = (chosen.elements, chosen.sides, chosen.kinds) == (list(ELEMENTS), list(SIDES), list(KINDS))
    name = "iterations" if full else "iterations_part"
    (RESULTS / f"{name}.jsonl").unlink(missing_ok=True)
    tasks = [*grid_tasks(chosen.elements, chosen.sides, chosen.kinds),
             *contrast_tasks(chosen.elements, chosen.sides, [k for k in chosen.kinds if k != "none"]),
             *(mixed_tasks(chosen.kinds) if full else ())]

    def report(found: list[dict[str, Any]]) -> None:
        for record in found:
            append_result(name, record)
        print("\n".join(lines(found)), flush=True)

    draw(measure(tasks, chosen.jobs, report)).savefig(RESULTS / f"{name}.png", dpi=150)


if __name__ == "__main__":
    main()

"""What a node costs against a pixel: the weights by which the mesh is cut and subdomains are dealt to ranks.

One region, cells of several sizes: the number of pixels stays, that of nodes changes, and the CPU seconds of the
phases that all ranks share are fitted by a * pixels + b * nodes.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from statistics import median

import numpy as np

from bench.support.rows import Row, append_result, main
from bench.support.runs import DATA, ddic_run, images
from ddic.partition.split import NODE_PIXELS

SIZE, MARGIN = 2112, 32
ELEMENTS = (12, 16, 20, 24, 32, 40)
CELLS_A_SUBDOMAIN = 600
ON_ONE_RANK = ("mesh", "start")
"""Phases that are rank 0's, whatever the partition."""


def seconds(element: int, wavelength: int) -> tuple[float, int, int]:
    """CPU seconds that are shared, pixels and nodes of a run; wavelength: l_c in elements."""
    folder = images("sinusoidal", "--size", f"{SIZE}x{SIZE}", folder=DATA / "cell_costs")
    n_cells = ((SIZE - 2 * MARGIN) // element) ** 2
    summary = ddic_run(f"""
[images]
reference = "{folder}/reference.tif"
deformed = "{folder}/deformed.tif"
[mesh.structured]
region = [{MARGIN}, {MARGIN}, {SIZE - MARGIN}, {SIZE - MARGIN}]
element_size = {element}
[regularization]
cut_off_wavelength = {wavelength * element}
[solver]
method = "dual"
subdomains = {max(1, round(n_cells / CELLS_A_SUBDOMAIN))}
""", folder, 1)
    shared = sum(value for name, value in summary["cpu_seconds"].items() if name not in ON_ONE_RANK)
    return shared, int(summary["n_pixels"]), int(summary["n_dofs"]) // 2


def fitted(elements: Sequence[int], wavelength: int, repeats: int) -> dict[str, object]:
    """Coefficients a and b of CPU seconds = a pixels + b nodes, by least squares on medians."""
    runs = [[seconds(element, wavelength) for element in elements] for _ in range(repeats)]
    cpu = np.array([median(run[k][0] for run in runs) for k in range(len(elements))])
    sizes = np.array([run[1:] for run in runs[0]], dtype=float)
    (a, b), *_ = np.linalg.lstsq(sizes, cpu, rcond=None)
    return {"elements_px": list(elements), "wavelength_elements": wavelength, "cpu_seconds": cpu.tolist(),
            "pixels": sizes[:, 0].tolist(), "nodes": sizes[:, 1].tolist(), "seconds_a_pixel": a, "seconds_a_node": b,
            "pixels_a_node": b / a, "largest_misfit_s": float(np.abs(sizes @ [a, b] - cpu).max())}


def measure(elements: Sequence[int] = ELEMENTS, repeats: int = 3) -> list[Row]:
    """Fit, and compare with the constant that ddic has."""
    record = fitted(elements, 4, repeats)
    append_result("cell_costs_fits", record)
    ratio = float(str(record["pixels_a_node"]))
    return [Row("cost of a node in pixels, l_c = 4 elements",
                f"within a factor 2 of NODE_PIXELS = {NODE_PIXELS:g}",
                f"{ratio:.0f} ({record['seconds_a_pixel']:.2e} s a pixel, {record['seconds_a_node']:.2e} s a node)",
                NODE_PIXELS / 2 <= ratio <= 2 * NODE_PIXELS)]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    main("cell_costs", lambda: measure(repeats=arguments.repeats))

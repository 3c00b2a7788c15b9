"""PGD-DIC through the command line: the same on every number of ranks, and a full-size pair."""

from __future__ import annotations

import numpy as np

from accept.full_size import HEIGHT, SMOKE_HEIGHT, SMOKE_WIDTH, WIDTH
from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_run, images
from ddic.io.result_reader import read_result
from ddic.synth.truth import load_truth

RANKS, SMOKE_RANKS = (1, 2, 4), (1, 2)
SAME_PX = 1e-10

SIZE, SMOKE_SIZE = 512, 200
"""Side of the images that are measured on several numbers of ranks, pixels."""

MARGIN, WAVELENGTH = 32, 64
"""Edge that is not measured, and cut-off wavelength, pixels."""


def _case(folder: object, width: int, height: int, element: int) -> str:
    return f"""
[images]
reference = "{folder}/reference.tif"
deformed = "{folder}/deformed.tif"
[mesh.structured]
region = [{MARGIN}, {MARGIN}, {width - MARGIN}, {height - MARGIN}]
element_size = {element}
[regularization]
cut_off_wavelength = {WAVELENGTH}
[pgd]
"""


def measure_ranks(scale: Scale) -> list[Row]:
    """Compare displacements on several numbers of ranks, with and without the update step.

    Parameters
    ----------
    scale : Scale
        A smoke run takes small images and two numbers of ranks.

    Returns
    -------
    list of Row
        One row.
    """
    size, ranks = (SMOKE_SIZE, SMOKE_RANKS) if scale.smoke else (SIZE, RANKS)
    folder = images("sinusoidal", "--size", f"{size}x{size}", folder=scale.folder("pgd_ranks"))
    largest = {}
    for update in ("true",) if scale.smoke else ("true", "false"):
        text = _case(folder, size, size, 1) + f"update = {update}\n"
        fields = []
        for n in ranks:
            ddic_run(text, folder, n, f"ranks_{n}_{update}")
            fields.append(read_result(folder / f"ranks_{n}_{update}.vtkhdf").displacement)
        largest[update] = max(float(np.abs(field - fields[0]).max()) for field in fields[1:])
    append_result("pgd_runs", {"check": "ranks", **largest})
    listed = "; ".join(f"{difference:.1e} px with update = {name}" for name, difference in largest.items())
    return [Row(f"{', '.join(map(str, ranks))} ranks, 1-px elements, {size} x {size} px: largest difference",
                f"<= {SAME_PX:.0e} px", listed, max(largest.values()) <= SAME_PX)]


def measure_full_size(scale: Scale) -> list[Row]:
    """Measure a 4384 x 6576 px pair with elements of a pixel on two ranks.

    Parameters
    ----------
    scale : Scale
        A smoke run takes small images.

    Returns
    -------
    list of Row
        One row.
    """
    width, height = (SMOKE_WIDTH, SMOKE_HEIGHT) if scale.smoke else (WIDTH, HEIGHT)
    folder = images("sinusoidal", "--size", f"{width}x{height}", "--bit-depth", "16", folder=scale.folder("full_size"))
    summary = ddic_run(_case(folder, width, height, 1), folder, 2, "pgd")
    result = read_result(folder / "pgd.vtkhdf")
    error = result.displacement - load_truth(folder / "truth.json").displacement(result.mesh.nodes)
    append_result("pgd_runs", {"check": "full_size", **summary})
    memory = ", ".join(f"{value / 2**20:.0f} MiB" for value in summary["peak_memory_bytes"])
    seconds = ", ".join(f"{name} {value:.1f}" for name, value in summary["seconds"].items())
    cpu = sum(summary["cpu_seconds"].values())
    return [Row(f"{height} x {width}, 16-bit TIFF pair, 1-px elements, cut-off {WAVELENGTH} px, 2 ranks",
                "runs; time and memory recorded",
                f"{summary['n_dofs']} unknowns, {summary['iterations']} corrections, {summary['n_modes']} modes; error "
                f"{np.sqrt((error**2).mean()):.4f} px; peak memory {memory}; {cpu:.0f} s CPU of both ranks; seconds: "
                f"{seconds}", bool(summary["converged"]), judged_small=False)]

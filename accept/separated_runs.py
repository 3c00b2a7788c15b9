"""PGD-DIC on the open-hole test beside Q4-DIC, and by the command line: on every number of ranks, and full size."""

from __future__ import annotations

import numpy as np

import ddic
from accept.real_images import HEIGHT, SMOKE_HEIGHT, SMOKE_WIDTH, WIDTH
from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_run, images, real_data
from bench.support.separated_cases import list_pixels
from ddic.io.result_reader import read_result
from ddic.synth.truth import load_truth

REGION = (580.0, 720.0, 820.0, 976.0)
"""Below the hole, inside the strip, pixels."""

SIZES, SMOKE_SIZES = (16, 8), (16,)
"""Sides of the elements, pixels."""

MOST, PAPER = 2e-3, (0.9e-3, 1.2e-3)
"""Difference in the whole vector's norm, and the paper's two."""

DEFAULTS_JUDGED_AT = 16
"""Elements, pixels, at which the default settings are judged too. On smaller ones they leave out more of Q4-DIC's noise
than the bound."""


def measure_separated_openhole(scale: Scale) -> list[Row]:
    """Measure frames 53 -> 70 by both methods."""
    folder = real_data() / "openhole"
    pair = (folder / "zoom-0053_1.tif", folder / "zoom-0070_1.tif")
    points, rows = list_pixels(REGION), []
    for size in SMOKE_SIZES if scale.smoke else SIZES:
        mesh = ddic.structured_mesh(REGION, size)
        q4 = ddic.measure(pair, mesh, solver={"method": "assembled"})
        known, differences, counts = q4.at(points), {}, {}
        for name, pgd in (("default", {}), ("published", {"update": False, "stop_at_noise": False}),
                          ("no stop at noise", {"stop_at_noise": False})):
            result = ddic.measure(pair, mesh, pgd=pgd)
            differences[name] = float(np.linalg.norm(result.at(points) - known) / np.linalg.norm(known))
            counts[name] = len(result.corrections["correction"])
        append_result("pgd_runs", {"check": "openhole", "size": size, "differences": differences, "counts": counts})
        listed = "; ".join(f"{name} {100 * one:.3f} % after {counts[name]} corrections"
                           for name, one in differences.items())
        judged = ("published", "default") if size == DEFAULTS_JUDGED_AT else ("published",)
        rows.append(Row(f"openhole 53 -> 70, a rectangle below the hole, {size}-px elements: difference to Q4-DIC in "
                        f"the whole vector's norm, {' and '.join(judged)}",
                        f"<= {100 * MOST:g} %; the paper's {100 * PAPER[0]:.2f} and {100 * PAPER[1]:.2f} %",
                        listed, all(differences[name] <= MOST for name in judged)))
    return rows


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
    """Compare displacements on several numbers of ranks, with and without the update step."""
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
    """Measure a 4384 x 6576 px pair with elements of a pixel on two ranks."""
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

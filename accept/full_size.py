"""What a full-size read costs: a 4384 x 6576, 16-bit TIFF pair on 2 ranks."""

from __future__ import annotations

from accept.support.settings import describe_settings
from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_run, images

WIDTH, HEIGHT, SUBDOMAINS = 6576, 4384, 180
SMOKE_WIDTH, SMOKE_HEIGHT, SMOKE_SUBDOMAINS = 352, 256, 6
"""Of the images, pixels, and the number of subdomains."""


def measure(scale: Scale) -> list[Row]:
    """Run once; memory by rank and seconds by phase go to bench/results/full_size_runs.jsonl.

    Parameters
    ----------
    scale : Scale
        A smoke run takes small images.

    Returns
    -------
    list of Row
        One row.
    """
    width, height, subdomains = ((SMOKE_WIDTH, SMOKE_HEIGHT, SMOKE_SUBDOMAINS) if scale.smoke
                                 else (WIDTH, HEIGHT, SUBDOMAINS))
    folder = images("sinusoidal", "--size", f"{width}x{height}", "--bit-depth", "16", folder=scale.folder("full_size"))
    case = f"""
[images]
reference = "{folder}/reference.tif"
deformed = "{folder}/deformed.tif"
[mesh.structured]
region = [32, 32, {width - 32}, {height - 32}]
element_size = 16
[regularization]
cut_off_wavelength = 64
[solver]
method = "dual"
subdomains = {subdomains}
"""
    summary = ddic_run(case, folder, 2)
    append_result("full_size_runs", summary)
    memory = ", ".join(f"{value / 2**20:.0f} MiB" for value in summary["peak_memory_bytes"])
    seconds = ", ".join(f"{name} {value:.1f}" for name, value in summary["seconds"].items())
    return [Row(f"4384 x 6576, 16-bit TIFF pair on 2 ranks, {describe_settings(case)}",
                "runs; memory by rank and seconds by phase recorded",
                f"{summary['n_dofs']} unknowns, {summary['iterations']} iterations; peak memory {memory}; "
                f"seconds: {seconds}", bool(summary["converged"]), judged_small=False)]

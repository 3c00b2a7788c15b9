"""What a full-size read costs: a 4384 x 6576, 16-bit TIFF pair on 2 ranks."""

from __future__ import annotations

from bench.support.rows import Row, append_result, main
from bench.support.runs import DATA, ddic_run, images

WIDTH, HEIGHT = 6576, 4384


def measure() -> list[Row]:
    """Run once; memory by rank and seconds by phase go to bench/results/full_size_runs.jsonl."""
    folder = images("sinusoidal", "--size", f"{WIDTH}x{HEIGHT}", "--bit-depth", "16", folder=DATA / "full_size")
    summary = ddic_run(f"""
[images]
reference = "{folder}/reference.tif"
deformed = "{folder}/deformed.tif"
[mesh.structured]
region = [32, 32, {WIDTH - 32}, {HEIGHT - 32}]
element_size = 16
[regularization]
cut_off_wavelength = 64
[solver]
subdomains = 180
""", folder, 2)
    append_result("full_size_runs", summary)
    memory = ", ".join(f"{value / 2**20:.0f} MiB" for value in summary["peak_memory_bytes"])
    seconds = ", ".join(f"{name} {value:.1f}" for name, value in summary["seconds"].items())
    return [Row("4384 x 6576, 16-bit TIFF pair on 2 ranks", "runs; memory by rank and seconds by phase recorded",
                f"{summary['n_dofs']} unknowns, {summary['iterations']} iterations; peak memory {memory}; "
                f"seconds: {seconds}", bool(summary["converged"]))]


if __name__ == "__main__":
    main("full_size", measure)

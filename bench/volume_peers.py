"""CPU seconds and error of ddic and its peers on the same volumes: al-dvc (subsets, then a field) and spam (subsets).

Usage: python -m bench.volume_peers [--size N] [--repeats N]

The volumes are al-dvc's own: a speckle that its generator smooths, stretched by 2 % along x by its own quintic spline,
32-bit floats, as in the table of its README. al-dvc takes subsets of 16 voxels every 8, its other settings by default;
spam the same subsets, cubic interpolation; ddic elements of 16 voxels, all else by default. Every program runs in a
process of its own with one thread, a small pair first. Seconds are CPU seconds from volumes on disk to the field in
memory; errors are those of a component, inside by two elements. Programs take turns, medians are compared. A JSON line
a run goes to bench/results/volume_peers.jsonl.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from bench.support.peer_environment import run_ddic, run_peer
from bench.support.rows import Row, append_result, show
from bench.support.runs import DATA
from ddic.io.result_reader import read_result

SUPPORT = Path(__file__).parent / "support"
SIZE, SMALL, REPEATS = 256, 64, 3
"""Side of the volumes and of those that go first, voxels; runs of each program."""

ELEMENT, SUBSET, STEP, STRETCH = 16, 16, 8, 0.02
"""Side of ddic's elements, of subsets, and the distance of their centres, voxels; the strain along x."""

MARGIN = 32
"""Edge in which no error is counted, voxels."""

LEAST = {"aldvc": 3, "spam": 50}
"""Times less CPU that ddic takes."""


def make_pair(size: int) -> Path:
    """Have al-dvc make a pair, once: reference.npy and deformed.npy in a folder."""
    folder = DATA / "volume_peers" / str(size)
    if not (folder / "deformed.npy").is_file():
        folder.mkdir(parents=True, exist_ok=True)
        run_peer(SUPPORT / "peer_aldvc_job.py", json.dumps({"make": str(folder), "size": size, "stretch": STRETCH}))
    return folder


def write_case(folder: Path, size: int) -> Path:
    """Write ddic's case, at defaults."""
    low, high = ELEMENT, size - ELEMENT
    path = folder / "ddic.toml"
    path.write_text(f"""
[volumes]
reference = "{folder}/reference.npy"
deformed = "{folder}/deformed.npy"
[mesh.structured]
region = [{low}, {low}, {low}, {high}, {high}, {high}]
element_size = {ELEMENT}
[output]
file = "ddic.vtkhdf"
""", encoding="utf-8")
    return path


def measure_error(points: Any, displacement: Any, size: int) -> float:
    """RMS error of a component at points inside, (n, 3), voxels."""
    inside = ((points >= MARGIN) & (points <= size - 1 - MARGIN)).all(axis=1)
    # al-dvc stretches about the middle.
    truth = (points - 0.5 * (size - 1)) * np.array([STRETCH, 0.0, 0.0])
    return float(np.sqrt(((displacement - truth)[inside]**2).mean()))


def run_program(name: str, size: int) -> dict[str, Any]:
    """Run a program once; its record, with cpu_seconds, whole_job_seconds and rms_error_px."""
    folder, small = make_pair(size), make_pair(SMALL)
    if name == "ddic":
        case, warm_up = write_case(folder, size), write_case(small, SMALL)
        record, whole = run_ddic("bench.support.peer_ddic_job", 1, str(warm_up), str(case))
        result = read_result(case.with_suffix(".vtkhdf"))
        points, displacement = result.mesh.nodes, result.displacement
    else:
        field = folder / f"{name}.npz"
        task = {"folder": str(folder), "warm_up": str(small), "field": str(field), "subset": SUBSET, "step": STEP,
                "margin": ELEMENT}
        record, whole = run_peer(SUPPORT / f"peer_{name}_job.py", json.dumps(task))
        with np.load(field) as found:
            points, displacement = found["points"], found["displacement"]
    record = {**record, "program": name, "size": size, "whole_job_seconds": whole,
              "rms_error_px": measure_error(points, displacement, size)}
    append_result("volume_peers", record)
    return record


def measure(size: int = SIZE, repeats: int = REPEATS) -> list[Row]:
    """Compare ddic with both peers."""
    runs: dict[str, list[dict[str, Any]]] = {"ddic": [], **{name: [] for name in LEAST}}
    for _ in range(repeats):
        for name, found in runs.items():
            found.append(run_program(name, size))
    return [_compare(name, runs["ddic"], runs[name], size) for name in LEAST]


def _compare(name: str, ours: Sequence[Mapping[str, Any]], theirs: Sequence[Mapping[str, Any]], size: int) -> Row:
    own, other = (median(run["cpu_seconds"] for run in found) for found in (ours, theirs))
    error, of_peer = ours[-1]["rms_error_px"], theirs[-1]["rms_error_px"]
    last = theirs[-1]
    return Row(f"{last['package']} {last['version']}, subsets of {SUBSET} voxels every {STEP}, speckle of al-dvc's "
               f"generator, {size}^3, {STRETCH:.0%} along x; ddic: Hex8 of {ELEMENT} voxels, no regularization, 1 rank",
               f"{LEAST[name]} times less CPU" + ("; error not above its" if name == "aldvc" else ""),
               f"{other / own:.1f} times less ({own:.1f} against {other:.1f} s, medians of {len(ours)}); RMS error "
               f"{error:.5f} against {of_peer:.5f} voxels; {last['n_unusable']} of its {last['n_points']} points did "
               f"not converge", other >= LEAST[name] * own and (name != "aldvc" or error <= of_peer),
               judged_small=False)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=SIZE, help="side of the volumes, voxels")
    parser.add_argument("--repeats", type=int, default=REPEATS)
    chosen = parser.parse_args()
    rows = measure(chosen.size, chosen.repeats)
    for row in rows:
        show(row)
    return 0 if all(row.holds for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())

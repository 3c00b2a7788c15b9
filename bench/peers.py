"""CPU seconds and error of ddic and of its peers on the same images: pyxel-dic (global), pyvale (subsets).

Usage: python -m bench.peers [--peers NAME ...] [--sizes SIZE ...] [--repeats N] [--method NAME]

All peers and sizes by default, which takes an hour; with --sizes 2048 it takes some minutes. --method is ddic's
solver.method, where it is not that of METHODS; rows name it.

Every program runs in a process of its own with one thread. Seconds are CPU seconds from images on disk to the field in
memory: process start, imports, compilation (a tiny pair goes first) and ddic's result file are left out; the ratio of
whole jobs, with all of these in, is beside it. Programs alternate, medians are compared. ddic runs on one rank, as its
peers do; its seconds on two ranks, both summed, are beside it too. The texture and the field are the reference ones.
A JSON line a comparison goes to bench/results/peers.jsonl, a line a run to peers_runs.jsonl.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from bench.support.peer_environment import run_ddic, run_peer
from bench.support.rows import Row, append_result, show
from bench.support.runs import DATA, images
from ddic.io.result_reader import read_result
from ddic.synth.truth import load_truth

SUPPORT = Path(__file__).parent / "support"
MARGIN, ELEMENT = 32, 16
WAVELENGTH = 80
"""The cut-off wavelength of every regularized run of ddic, px: one for images with and without noise."""
SIZES = {"2048": (2112, 2112), "4096": (4160, 4160), "29mpx": (6576, 4384), "tiny": (256, 256)}
"""Image width and height, px; 2048 and 4096 are the mesh's sides, a margin inside;
tiny, to see that everything runs, is measured where it is asked for."""
METHODS = {"pyxel": None, "pyvale": "conjugate_gradient"}
"""ddic's solver.method against each peer, None for its default; with l_c of a few elements nothing is factorised."""
PLAN = {"pyxel": ("2048", "4096"), "pyvale": ("2048", "29mpx")}
REPEATS, REPEATS_LARGE = 3, 1
"""Of each program; pyxel needs ten minutes for one measurement of size 4096."""
LEAST_OWN, LEAST_COMPILED, LEAST_SUBSETS = 50, 12, 5
BOUNDED_SUBSETS = "29mpx"
MOST_ERROR = {0: 0.0012, 2: 0.0031}
"""RMS error of ddic's regularized field by the noise's standard deviation in grey levels, px."""
SUBSETS = {"subset_size": 31, "subset_step": 16}
QUICK_SUBSETS = {**SUBSETS, "method": "SINGLEWINDOW_RG", "max_displacement": 16}
"""pyvale's quickest settings on this field: a search as short as its displacement allows."""


@dataclass(frozen=True)
class Pair:
    """An image pair: its files, the images' size (px), its noise (grey levels)."""

    folder: Path
    width: int
    height: int
    noise: int

    def error(self, points: Any, displacement: Any) -> float:
        """RMS error per component at points (n, 2), pixels."""
        error = displacement - load_truth(self.folder / "truth.json").displacement(points)
        return float(np.sqrt((error**2).mean()))

    @property
    def region(self) -> list[float]:
        """The corners x0, y0, x1, y1 of the mesh, pixels."""
        # Between pixels: every program has the same ones, and pyxel's integration points are pixels, which is its best.
        return [MARGIN - 0.5, MARGIN - 0.5, self.width - MARGIN - 0.5, self.height - MARGIN - 0.5]

    def inner(self, points: Any) -> Any:
        """Which points lie more than one element inside the mesh's border."""
        inset = 1.01 * ELEMENT
        low, high = np.array(self.region).reshape(2, 2)
        return ((points > low + inset) & (points < high - inset)).all(axis=1)


@dataclass(frozen=True)
class Run:
    """One run of one program: CPU seconds to the field and of the whole job, RMS error (px), what it says of itself."""

    seconds: float
    whole: float
    error: float
    record: Mapping[str, Any]


Programs = Mapping[str, Callable[[], Run]]


def image_pair(width: int, height: int, noise: int) -> Pair:
    """The reference texture and field, 8 bit."""
    size = f"{width}x{height}"
    folder = images("sinusoidal", "--size", size, "--noise", str(noise), folder=DATA / "peers" / f"{size}_noise{noise}")
    return Pair(folder, width, height, noise)


def warm_up_pair() -> Pair:
    """A pair that takes a moment."""
    return image_pair(256, 256, 0)


def case_file(pair: Pair, wavelength: int, method: str | None, name: str) -> Path:
    """Write ddic's case, at defaults but for the regularization and, where given, solver.method; returns the file."""
    regularization = f"[regularization]\ncut_off_wavelength = {wavelength}\n" if wavelength else ""
    solver = f'[solver]\nmethod = "{method}"\n' if method else ""
    path = pair.folder / f"{name}.toml"
    path.write_text(f"""
[images]
reference = "{pair.folder}/reference.tif"
deformed = "{pair.folder}/deformed.tif"
[mesh.structured]
region = {pair.region}
element_size = {ELEMENT}
{regularization}{solver}[output]
file = "{name}.vtkhdf"
""", encoding="utf-8")
    return path


def measure_ddic(pair: Pair, wavelength: int, n_ranks: int, method: str | None) -> Run:
    """Measure with ddic in a job of some ranks; the error is that of the field that the job timed."""
    name = f"ddic_lc{wavelength}_ranks{n_ranks}"
    case, warm_up = (case_file(p, wavelength, method, name) for p in (pair, warm_up_pair()))
    record, whole = run_ddic("bench.support.peer_ddic_job", n_ranks, str(warm_up), str(case))
    result = read_result(case.with_suffix(".vtkhdf"))
    inner = pair.inner(result.mesh.nodes)
    return Run(record["cpu_seconds"], whole, pair.error(result.mesh.nodes[inner], result.displacement[inner]), record)


def pyxel(pair: Pair, interpolation: str) -> Run:
    """Measure with pyxel on ddic's mesh; interpolation: "own" or "compiled"."""
    record, whole, points, displacement = measure_peer("pyxel", pair,
                                                            {"element": ELEMENT, "interpolation": interpolation})
    inner = pair.inner(points)
    return Run(record["cpu_seconds"], whole, pair.error(points[inner], displacement[inner]), record)


def pyvale(pair: Pair, settings: Mapping[str, Any]) -> Run:
    """Measure with pyvale in ddic's region; the error is at its points, which begin 15 px inside the region."""
    record, whole, points, displacement = measure_peer("pyvale", pair, {"settings": settings})
    return Run(record["cpu_seconds"], whole, pair.error(points, displacement), record)


def measure_peer(name: str, pair: Pair, task: Mapping[str, Any]) -> tuple[dict[str, Any], float, Any, Any]:
    """Record, CPU seconds of the whole job, points (n, 2) and displacement (n, 2) of a peer, pixels."""
    field = pair.folder / f"{name}.npz"
    whole_task = {"folder": str(pair.folder), "warm_up": str(warm_up_pair().folder), "margin": MARGIN,
                  "field": str(field), **task}
    record, whole = run_peer(SUPPORT / f"peer_{name}_job.py", json.dumps(whole_task))
    with np.load(field) as found:
        return record, whole, found["points"], found["displacement"]


def alternate(case: str, programs: Programs, order: Sequence[str], repeats: int) -> dict[str, list[Run]]:
    """Run the programs in the given order, as often as asked; every run is kept in peers_runs.jsonl."""
    runs: dict[str, list[Run]] = {name: [] for name in programs}
    for _ in range(repeats):
        for name in order:
            run = programs[name]()
            append_result("peers_runs", {"case": case, "program": name, **asdict(run)})
            runs[name].append(run)
    return runs


def comparison(peer: str, case: str, runs: Mapping[str, Sequence[Run]], names: tuple[str, str],
               **more: Any) -> dict[str, Any]:
    """The record of a comparison; names: of ddic's runs and of the peer's."""
    ours, theirs = (runs[name] for name in names)
    own, other = (median(run.seconds for run in found) for found in (ours, theirs))
    whole, other_whole = (median(run.whole for run in found) for found in (ours, theirs))
    return {"peer": peer, "case": case, "cpu_ratio": other / own, "rms_error_px": ours[-1].error,
            "peer_rms_error_px": theirs[-1].error, "whole_job_ratio": other_whole / whole, "cpu_seconds": own,
            "peer_cpu_seconds": other, "whole_job_seconds": whole, "peer_whole_job_seconds": other_whole,
            "runs": len(ours), "peer_runs": len(theirs), "peer_version": theirs[-1].record["version"],
            "peer_points": theirs[-1].record["n_points"], "peer_unusable_points": theirs[-1].record["n_unusable"],
            "iterations": ours[-1].record["iterations"], "phases": ours[-1].record["phases"], **more}


def said(record: Mapping[str, Any], beside: str) -> str:
    """A comparison in words."""
    return (f"{record['cpu_ratio']:.1f} times less CPU ({record['cpu_seconds']:.2f} against "
            f"{record['peer_cpu_seconds']:.2f} s, medians of {record['runs']} and {record['peer_runs']}); RMS error "
            f"{record['rms_error_px']:.5f} against {record['peer_rms_error_px']:.5f} px; whole job "
            f"{record['whole_job_ratio']:.1f} times less; {beside}")


def times(runs: Mapping[str, Sequence[Run]], names: tuple[str, str]) -> str:
    """The ratio of two programs' CPU seconds and the RMS error of the first."""
    own, other = (median(run.seconds for run in runs[name]) for name in names)
    return f"{other / own:.1f} times (RMS error {runs[names[0]][-1].error:.5f} px)"


def solved_by(method: str | None) -> str:
    """How a row names a method that is not ddic's default."""
    return f", method {method}" if method else ""


def kept(record: dict[str, Any], check: str, bound: str, beside: str, holds: bool) -> Row:
    """Append a comparison to bench/results/peers.jsonl; returns its row."""
    append_result("peers", {**record, "bound": bound, "holds": holds})
    return Row(check, bound, said(record, beside), holds, judged_small=False)


def against_pyxel(size: str, repeats: int, method: str | None) -> Iterator[Row]:
    """Same images, mesh and problem: pyxel's own interpolation, then a compiled one in its place."""
    pair = image_pair(*SIZES[size], 0)
    case = f"{size} x {size} px, 8 bit, {ELEMENT}-px Q4"
    programs = {"ddic": partial(measure_ddic, pair, 0, 1, method), "2 ranks": partial(measure_ddic, pair, 0, 2, method),
                "regularized": partial(measure_ddic, pair, WAVELENGTH, 1, method), "own": partial(pyxel, pair, "own"),
                "compiled": partial(pyxel, pair, "compiled")}
    runs = alternate(case, programs, ("ddic", "own", "2 ranks", "compiled", "ddic", "regularized"), repeats)
    for peer, name, least in (("pyxel-dic", "own", LEAST_OWN),
                              ("pyxel-dic, compiled interpolation", "compiled", LEAST_COMPILED)):
        record = comparison(peer, case, runs, ("ddic", name), region=pair.region, noise_grey=0, cut_off_wavelength=None,
                            method=method)
        beside = (f"on 2 ranks, summed, {times(runs, ('2 ranks', name))}; with l_c = {WAVELENGTH} px "
                  f"{times(runs, ('regularized', name))}")
        holds = record["cpu_ratio"] >= least and record["rms_error_px"] <= record["peer_rms_error_px"]
        yield kept(record, f"{peer} {record['peer_version']}, {case}, no regularization{solved_by(method)}",
                   f">= {least} times less CPU at an RMS error no worse", beside, holds)


def against_pyvale(size: str, repeats: int, method: str | None) -> Iterator[Row]:
    """Same images and region: subsets of 31 px every 16 px against Q4 of 16 px with the equilibrium gap."""
    for noise, most in MOST_ERROR.items():
        pair = image_pair(*SIZES[size], noise)
        case = f"{pair.width} x {pair.height} px images, 8 bit, noise {noise} grey levels"
        programs = {"ddic": partial(measure_ddic, pair, WAVELENGTH, 1, method),
                    "2 ranks": partial(measure_ddic, pair, WAVELENGTH, 2, method),
                    "pyvale": partial(pyvale, pair, SUBSETS),
                    "quickest": partial(pyvale, pair, QUICK_SUBSETS)}
        runs = alternate(case, programs, ("ddic", "pyvale", "2 ranks", "quickest"), repeats)
        record = comparison("pyvale", case, runs, ("ddic", "pyvale"), region=pair.region, noise_grey=noise,
                            cut_off_wavelength=WAVELENGTH, method=method)
        beside = (f"on 2 ranks, summed, {times(runs, ('2 ranks', 'pyvale'))}; against pyvale's quickest search "
                  f"{times(runs, ('ddic', 'quickest'))}")
        least = LEAST_SUBSETS if size == BOUNDED_SUBSETS else 0
        bound = f"RMS error <= {most} px" + (f" at >= {least} times less CPU" if least else "")
        holds = record["cpu_ratio"] >= least and record["rms_error_px"] <= most
        check = (f"pyvale {record['peer_version']}, subsets of 31 px, step 16, {case}; ddic: {ELEMENT}-px Q4, "
                 f"l_c = {WAVELENGTH} px{solved_by(method)}")
        yield kept(record, check, bound, beside, holds)


PEERS = {"pyxel": against_pyxel, "pyvale": against_pyvale}


def rows(peer: str, sizes: Sequence[str] | None = None, repeats: int | None = None,
         method: str | None = None) -> Iterator[Row]:
    """The rows of a peer as they are measured."""
    method = method or METHODS[peer]
    # Compiles what the first measured job would otherwise compile within its whole-job seconds.
    for wavelength, n_ranks in ((0, 1), (WAVELENGTH, 1), (WAVELENGTH, 2)):
        measure_ddic(warm_up_pair(), wavelength, n_ranks, method)
    for size in SIZES:
        if size in (PLAN[peer] if sizes is None else sizes) and size in (*PLAN[peer], "tiny"):
            default = REPEATS_LARGE if (peer, size) == ("pyxel", "4096") else REPEATS
            yield from PEERS[peer](size, repeats or default, method)


def measure(peer: str | None = None) -> list[Row]:
    """All rows of one peer ("pyxel", "pyvale"), or of both."""
    return [row for name in ([peer] if peer else PEERS) for row in rows(name)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peers", nargs="+", choices=PEERS, default=list(PEERS))
    parser.add_argument("--sizes", nargs="+", choices=SIZES, default=[size for size in SIZES if size != "tiny"])
    parser.add_argument("--repeats", type=int, help=f"default {REPEATS}, {REPEATS_LARGE} of pyxel at 4096")
    parser.add_argument("--method", help="ddic's solver.method against all peers")
    chosen = parser.parse_args()
    held = True
    for peer in chosen.peers:
        for row in rows(peer, chosen.sizes, chosen.repeats, chosen.method):
            held &= row.holds
            show(row)
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())

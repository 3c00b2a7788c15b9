"""Pairs of large volumes on two ranks, from files to the result: 512^3 and 1024^3 voxels.

Usage: python -m bench.large_volumes [SIDE ...], 512 and 1024 by default.

The sum of three periodic speckles, and the same moved by a known translation, exactly: by the phase of its Fourier
coefficients, of which a smooth speckle has none near the voxel's own frequency. Cubes of PERIODS are repeated, the sum
of which does not repeat itself; 8 bit, raw numbers with a sidecar. Time, memory and error go to
bench/results/large_volumes.jsonl.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from bench.support.paper_record import timed
from bench.support.rows import Row, append_result, show_all
from bench.support.runs import DATA
from ddic.io.result_reader import read_result

PERIODS, SPECKLE, TRANSLATION = (256, 240, 208), 2.0, (1.3, -0.7, 2.4)
"""Sides of the cubes that are repeated; smoothing of the speckle; what moves it, along x, y and z; voxels."""

MARGIN, ELEMENT, MOST_ERROR = 16, 16, 0.003
"""Edge without elements, side of the elements, RMS error of a component; voxels."""

N_RANKS, REPEATS = 2, 3


@dataclass(frozen=True)
class Large:
    """A pair: the cut-off wavelength, 0 for none, voxels; and what a run may take, seconds by the clock and GiB."""

    wavelength: float
    most_seconds: float
    most_memory: float
    repeats: int


SIZES = {512: Large(0, 20, 1.6, REPEATS), 1024: Large(4 * ELEMENT, 300, 12, 1)}
"""By the side in voxels."""


def make_pair(side: int) -> Path:
    """Write a pair, once; returns its folder."""
    folder = DATA / f"large_volume_{side}"
    if (folder / "deformed.raw.toml").is_file():
        return folder
    folder.mkdir(parents=True, exist_ok=True)
    speckles = [_draw_speckle(number, period) for number, period in enumerate(PERIODS)]
    # Order of the axes: planes, rows, columns.
    moved = [np.fft.ifftn(ndimage.fourier_shift(np.fft.fftn(tile), TRANSLATION[::-1])).real for tile in speckles]
    for name, tiles in (("reference", speckles), ("deformed", moved)):
        _repeat(folder / f"{name}.raw", [tile.astype(np.float32) for tile in tiles], side)
    return folder


def _draw_speckle(seed: int, period: int) -> NDArray[np.float64]:
    """Draw a periodic cube of mean 0 and deviation 1."""
    noise = np.random.default_rng(seed).standard_normal((period,) * 3)
    smooth = ndimage.gaussian_filter(noise, SPECKLE, mode="wrap")
    return np.asarray((smooth - smooth.mean()) / smooth.std())


def _repeat(path: Path, tiles: list[NDArray[np.float32]], side: int) -> None:
    """Write the sum of tiles, each again and again, plane by plane, then its sidecar."""
    places = np.arange(side)
    with path.open("wb") as stream:
        for plane in range(side):
            total = sum(tile[plane % len(tile)][np.ix_(places % len(tile), places % len(tile))] for tile in tiles)
            grey = 128 + 40 / np.sqrt(len(tiles)) * total
            stream.write(np.clip(np.rint(grey), 0, 255).astype(np.uint8).tobytes())
    path.with_name(path.name + ".toml").write_text(f'shape = [{side}, {side}, {side}]\ntype = "uint8"\n',
                                                   encoding="utf-8")


def write_case(folder: Path, side: int, wavelength: float) -> str:
    """Give the case, without its output."""
    low, high = MARGIN, side - MARGIN
    regularization = f"[regularization]\ncut_off_wavelength = {wavelength:g}\n" if wavelength else ""
    return f"""[volumes]
reference = "{folder}/reference.raw"
deformed = "{folder}/deformed.raw"
[mesh.structured]
region = [{low}, {low}, {low}, {high}, {high}, {high}]
element_size = {ELEMENT}
{regularization}"""


def measure(side: int) -> Row:
    """Measure one size."""
    large, folder = SIZES.get(side, SIZES[512]), make_pair(side)
    text = write_case(folder, side, large.wavelength)
    runs = sorted((timed(text, folder, N_RANKS, "result") for _ in range(large.repeats)), key=lambda run: run.wall_s)
    chosen = runs[len(runs) // 2]
    error = read_result(folder / "result.vtkhdf").displacement - np.array(TRANSLATION)
    rms, memory = float(np.sqrt((error**2).mean())), sum(chosen.summary["peak_memory_bytes"]) / 2**30
    append_result("large_volumes", {"side": side, "wall_s": [run.wall_s for run in runs], "rms_error_px": rms,
                                    **chosen.summary})
    gap = f"l_c = {large.wavelength:g} voxels" if large.wavelength else "no regularization"
    return Row(f"{side}^3, 8 bit, raw, translation of {TRANSLATION} voxels, Hex8 of {ELEMENT} voxels, {gap}, {N_RANKS} "
               "ranks: whole command",
               f"<= {large.most_seconds:g} s, <= {large.most_memory:g} GiB; RMS error of all nodes <= {MOST_ERROR}",
               f"{chosen.wall_s:.1f} s by the clock (median of {len(runs)}), "
               f"{sum(chosen.summary['cpu_seconds'].values()):.1f} CPU s in the phases, {memory:.2f} GiB; RMS error "
               f"{rms:.5f} voxels; {chosen.summary['n_dofs']} unknowns, {chosen.summary['iterations']} iterations",
               chosen.wall_s <= large.most_seconds and memory <= large.most_memory and rms <= MOST_ERROR,
               judged_small=False)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sides", nargs="*", type=int, default=list(SIZES), metavar="SIDE", help="voxels")
    return show_all([measure(side) for side in parser.parse_args().sides])


if __name__ == "__main__":
    sys.exit(main())

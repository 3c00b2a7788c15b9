"""Pairs of which nothing is spoilt, measured by defaults and with every pixel kept.

Usage: python -m accept.support.clean_pairs [--only FIELD ...] [--lc none 64 80 128] [--noise 0 2 5] [--to FILE]
[--small]: a line for each pair, and a JSON line in FILE.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ddic
from accept.support import clean_fields
from accept.support.clean_fields import (
    Motion,
    draw_speckles,
    find_origins,
    make_crack,
    make_hole,
    make_neck,
    make_turned_waves,
    make_waves,
)
from bench.support.runs import DATA

Array = NDArray[np.float64]
Pair = tuple[NDArray[np.uint8], NDArray[np.uint8]]

CUT_OFFS: tuple[float | None, ...] = (None, 64.0, 80.0, 128.0)
NOISES = (0.0, 2.0, 5.0)
SPECKLES = (0.75, 1.0, 1.5)
"""Of the pairs: l_c, pixels; noise, grey levels; size of the speckles, times the reference size."""

LARGE, SMALL = 576, 192
"""Height of the region, pixels, in full and in a smoke run: whole elements of 12 and of 16 px."""

MARGIN, TURNED_MARGIN = 64, 112
"""Of the images about the region, pixels; a rotation needs more."""

WAVES: dict[float | None, tuple[tuple[float, float], ...]] = {
    None: ((150.0, 0.11), (300.0, 0.12), (500.0, 0.10)), 64.0: ((150.0, 0.10), (200.0, 0.10), (250.0, 0.10)),
    80.0: ((200.0, 0.10), (250.0, 0.09), (300.0, 0.08)), 128.0: ((250.0, 0.05), (300.0, 0.05), (400.0, 0.07))}
TURNED_WAVES: dict[float | None, tuple[tuple[float, float], ...]] = {
    None: ((150.0, 0.11), (300.0, 0.10), (500.0, 0.08)), 64.0: ((150.0, 0.08), (200.0, 0.09), (250.0, 0.08)),
    80.0: ((200.0, 0.07), (250.0, 0.08), (300.0, 0.08)), 128.0: ((250.0, 0.04), (300.0, 0.05), (400.0, 0.06))}
"""Wavelength, pixels, and largest strain by l_c, one for each noise: l_c holds them back by one to three pixels at
edges and crests, as far as what keeps every pixel still converges."""

HELD_BACK = 4
"""Value of the cell field ``excluded`` that marks cells whose pixels all count."""


@dataclass(frozen=True)
class CleanCase:
    """What a pair is drawn with, and measured.

    Attributes
    ----------
    field : str
        One of FIELDS.
    cut_off : float or None
        l_c, pixels.
    noise : float
        Standard deviation, grey levels.
    speckle : float
        Size of the speckles, times the reference size.
    height : int
        Of the region, pixels.
    """

    field: str
    cut_off: float | None
    noise: float
    speckle: float
    height: int = LARGE

    @property
    def name(self) -> str:
        """What it is called in a table."""
        length = "no l_c" if self.cut_off is None else f"l_c {self.cut_off:g}"
        return f"{self.field}, {length}, noise {self.noise:g}, speckle {self.speckle:g}"

    @property
    def margin(self) -> int:
        """Of the images about the region, pixels."""
        return TURNED_MARGIN if self.field == "turned" else MARGIN

    @property
    def width(self) -> int:
        """Of the region, pixels: longer than high, but for a rotation."""
        return self.height if self.field == "turned" or self.height == SMALL else self.height * 7 // 6

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the images, pixels."""
        return self.width + 2 * self.margin, self.height + 2 * self.margin

    @property
    def centre(self) -> Array:
        """Of the images, pixels, between grid lines of the mesh."""
        return np.asarray(np.array(self.size) / 2 + np.array([3.3, -2.7]))

    @property
    def element(self) -> int:
        """Side of the elements, pixels."""
        return 12 if self.speckle < 1 else 16

    @property
    def hole_radius(self) -> float:
        """Of the plate, pixels; smaller where there is more noise."""
        return self.height * (0.14, 0.1, 0.07)[NOISES.index(self.noise)]

    def make_motion(self) -> Motion:
        """Displacement, the same whenever it is asked for."""
        return FIELDS[self.field](self)

    def make_mesh(self) -> ddic.Mesh:
        """Elements on the region, the hole left out."""
        low, (width, height) = self.margin, (self.width, self.height)
        region = (low, low, low + width, low + height)
        if self.field != "hole":
            return ddic.structured_mesh(region, self.element)
        return ddic.structured_mesh(region, self.element, circles=[(tuple(self.centre), self.hole_radius)])


def _make_waves(case: CleanCase) -> Motion:
    return make_waves(*WAVES[case.cut_off][NOISES.index(case.noise)])


def _make_turned(case: CleanCase) -> Motion:
    return make_turned_waves(case.centre, *TURNED_WAVES[case.cut_off][NOISES.index(case.noise)])


def _make_hole(case: CleanCase) -> Motion:
    return make_hole(case.centre, case.hole_radius, (0.03, 0.02, 0.01)[NOISES.index(case.noise)])


def _make_crack(case: CleanCase) -> Motion:
    return make_crack(0.4 * case.size[0], (2.0, 1.5, 1.0)[NOISES.index(case.noise)])


def _make_neck(case: CleanCase) -> Motion:
    narrowest = 0.12 if case.cut_off == CUT_OFFS[-1] else 0.1
    return make_neck(case.centre, case.height * (narrowest, 0.14, 0.2)[NOISES.index(case.noise)], 0.13)


FIELDS: dict[str, Callable[[CleanCase], Motion]] = {
    "waves": _make_waves, "hole": _make_hole, "crack": _make_crack, "neck": _make_neck, "turned": _make_turned}


def list_cases(height: int = LARGE) -> list[CleanCase]:
    """List the pairs: every field with every l_c and noise, the speckles' sizes in turn.

    Parameters
    ----------
    height : int
        Of the region, pixels.

    Returns
    -------
    list of CleanCase
        60.
    """
    return [CleanCase(field, cut_off, noise, SPECKLES[(f + c + n) % len(SPECKLES)], height)
            for f, field in enumerate(FIELDS) for c, cut_off in enumerate(CUT_OFFS) for n, noise in enumerate(NOISES)]


def draw_pair(case: CleanCase) -> Pair:
    """Draw a pair, or read it where it was drawn before.

    Parameters
    ----------
    case : CleanCase
        What of.

    Returns
    -------
    reference, deformed : (height, width) uint8 array
        Grey levels.
    """
    path = DATA / "clean" / f"{case.field}_{_digest(case)}.npy"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, np.stack(_render(case)))
    reference, deformed = np.load(path)
    return reference, deformed


def _digest(case: CleanCase) -> str:
    """Tells apart what is drawn: sizes, noise, texture and the motion at some points."""
    width, height = case.size
    points = np.random.default_rng(0).random((20, 2)) * [width, height]
    moved = case.make_motion()(points).round(6)
    texture = Path(clean_fields.__file__).read_bytes()
    drawn = [str((case.size, case.noise, case.speckle)).encode(), moved.tobytes(), texture]
    return hashlib.sha256(b"".join(drawn)).hexdigest()[:16]


def _render(case: CleanCase) -> Pair:
    width, height = case.size
    y, x = np.mgrid[0:height, 0:width].astype(float)
    points = np.column_stack([x.ravel(), y.ravel()])
    origins = find_origins(case.make_motion(), points)
    seed = list(FIELDS).index(case.field) + 10 * SPECKLES.index(case.speckle)
    low, high = np.minimum(origins.min(axis=0), 0.0), np.maximum(origins.max(axis=0), [width, height])
    speckles = draw_speckles(low, high, case.speckle, seed)
    random = np.random.default_rng(seed + 1000)
    images = []
    for shown in (points, origins):
        levels = speckles.grey(shown) + case.noise * random.standard_normal(len(points))
        images.append(np.clip(np.rint(levels), 0, 255).astype(np.uint8).reshape(height, width))
    return images[0], images[1]


@dataclass(frozen=True, eq=False)
class Measured:
    """A measurement of a pair.

    Attributes
    ----------
    displacement : (n_nodes, 2) array
        Pixels.
    states : (n_cells,) array
        The cell field "excluded".
    n_pixels : int
        That count, of all cells.
    iterations : int
        Of Gauss-Newton, all rounds.
    seconds : float
        Of this process's CPU.
    """

    displacement: Array
    states: NDArray[np.uint8]
    n_pixels: int
    iterations: int
    seconds: float


@dataclass(frozen=True)
class Compared:
    """Defaults beside a measurement that keeps every pixel.

    Attributes
    ----------
    name : str
        Of the case.
    refusal : str
        Why it could not be measured; empty where both measurements converged.
    n_excluded, n_held_back : int
        Cells, those that are marked though their pixels count apart.
    n_pixels, n_pixels_lost : int
        That count where every pixel is kept, and how many fewer by default.
    iterations, iterations_keep : int
        Of Gauss-Newton.
    rms, rms_keep : float
        Error at the nodes, pixels.
    largest, largest_keep : float
        Of a node, pixels.
    largest_change : float
        Between both, of a node, pixels.
    seconds, seconds_keep : float
        CPU.
    """

    name: str
    refusal: str = ""
    n_excluded: int = 0
    n_held_back: int = 0
    n_pixels: int = 0
    n_pixels_lost: int = 0
    iterations: int = 0
    iterations_keep: int = 0
    rms: float = np.nan
    rms_keep: float = np.nan
    largest: float = np.nan
    largest_keep: float = np.nan
    largest_change: float = np.nan
    seconds: float = 0.0
    seconds_keep: float = 0.0

    @property
    def misses(self) -> tuple[str, ...]:
        """Bounds that it misses, in words; none where it is as it should be."""
        if self.refusal:
            return (self.refusal,)
        missed = {
            "cells": self.n_excluded > 0,
            "pixels": self.n_pixels_lost > MOST_PIXELS * self.n_pixels,
            "field": self.largest_keep < HELD_OFF and not self.largest_change <= EQUAL_PX,
            "error": self.largest_keep >= HELD_OFF and not self.rms <= WORSE * self.rms_keep,
            "iterations": self.iterations > MORE_ITERATIONS * self.iterations_keep + 3,
        }
        return tuple(what for what, is_missed in missed.items() if is_missed)

    def tell(self) -> str:
        """One line."""
        if self.refusal:
            return f"MISSED {self.name}: {self.refusal}"
        verdict = f"MISSED {'+'.join(self.misses)}" if self.misses else "ok"
        return (f"{verdict:7s} {self.name}: cells {self.n_excluded} (held back {self.n_held_back}), pixels "
                f"{self.n_pixels_lost}, iterations {self.iterations}/{self.iterations_keep}, RMS {self.rms:.4f}/"
                f"{self.rms_keep:.4f}, largest {self.largest:.2f}/{self.largest_keep:.2f}, change "
                f"{self.largest_change:.1e} px, CPU {self.seconds:.1f}/{self.seconds_keep:.1f} s")


MOST_PIXELS = 1e-5
"""Share of a clean pair's pixels that may be excluded."""

HELD_OFF, EQUAL_PX, WORSE = 1.0, 1e-3, 1.02
"""Error of a node, pixels, from which on a field counts as held off; below it, largest change at a node by what is
excluded, pixels; from it on, RMS error, times that of a measurement that keeps every pixel."""

MORE_ITERATIONS = 1.5
"""Times those where every pixel is kept, and 3 more."""


def compare(case: CleanCase) -> Compared:
    """Measure a pair by defaults and with every pixel kept."""
    pair, mesh = draw_pair(case), case.make_mesh()
    truth = case.make_motion()(mesh.nodes)
    found, refused = [], []
    for correlation in ({}, {"spoilt_pixels": "keep"}):
        try:
            found.append(_measure(case, pair, mesh, correlation))
        except Exception as error:
            # Whatever goes wrong is a pair that is not measured, and no other pair's business.
            refused.append(f"{'keep' if correlation else 'default'}: {str(error).splitlines()[0]}")
    if refused:
        return Compared(case.name, "; ".join(refused))
    default, keep = found
    off, off_keep = (one.displacement - truth for one in found)
    is_excluded = (default.states != 0) & (default.states != HELD_BACK)
    return Compared(
        case.name, "", int(is_excluded.sum()), int((default.states == HELD_BACK).sum()), keep.n_pixels,
        keep.n_pixels - default.n_pixels, default.iterations, keep.iterations, _rms(off), _rms(off_keep), _largest(off),
        _largest(off_keep), _largest(default.displacement - keep.displacement), default.seconds, keep.seconds)


def _measure(case: CleanCase, pair: Pair, mesh: ddic.Mesh, correlation: dict[str, Any]) -> Measured:
    options: dict[str, Any] = {"correlation": correlation} if correlation else {}
    if case.cut_off is not None:
        options["regularization"] = {"cut_off_wavelength": case.cut_off}
    begin = time.process_time()
    result = ddic.measure(pair, mesh, **options)
    seconds = time.process_time() - begin
    return Measured(result.displacement, result.cell_data["excluded"], int(result.cell_data["residual_n_pixels"].sum()),
                    int((result.gauss_newton["of_slow_nodes"] == 0).sum()), seconds)


def _rms(off: Array) -> float:
    """Of nodes that have a value."""
    return float(np.sqrt(np.nanmean(off**2)))


def _largest(off: Array) -> float:
    return float(np.nanmax(np.linalg.norm(off, axis=1)))


def compare_all(cases: Sequence[CleanCase], file: Path | None = None) -> Iterator[Compared]:
    """Measure pairs, one after the other."""
    for case in cases:
        compared = compare(case)
        if file is not None:
            record = {**asdict(compared), "case": asdict(case), "misses": compared.misses}
            with file.open("a", encoding="utf-8") as lines:
                lines.write(json.dumps(record) + "\n")
        yield compared


def main() -> None:
    """Measure the pairs that the command line names."""
    parser = argparse.ArgumentParser(prog="python -m accept.support.clean_pairs")
    parser.add_argument("--only", nargs="*", default=list(FIELDS), choices=list(FIELDS))
    parser.add_argument("--lc", nargs="*", default=["none", "64", "80", "128"], help="cut-off wavelengths, px, or none")
    parser.add_argument("--noise", nargs="*", type=float, default=list(NOISES))
    parser.add_argument("--to", type=Path, default=None, help="file to which JSON lines are appended")
    parser.add_argument("--small", action="store_true", help="images of some 300 px")
    parser.add_argument("--draw", action="store_true", help="only draw the images")
    chosen = parser.parse_args()
    cut_offs = [None if text == "none" else float(text) for text in chosen.lc]
    cases = [case for case in list_cases(SMALL if chosen.small else LARGE)
             if case.field in chosen.only and case.cut_off in cut_offs and case.noise in chosen.noise]
    if chosen.draw:
        for case in cases:
            draw_pair(case)
        return
    missed = 0
    for compared in compare_all(cases, chosen.to):
        missed += bool(compared.misses)
        print(compared.tell(), flush=True)
    print(f"{missed} of {len(cases)} pairs miss a bound")


if __name__ == "__main__":
    main()

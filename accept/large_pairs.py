"""How long starts of 29-megapixel pairs take: a rotation by 300 px, and what a translation was enough for before."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from accept.support.deformed_pair import make_rotation
from accept.table import Scale
from bench.support.before import checkout_before
from bench.support.rows import Row, append_result
from bench.support.runs import ROOT, images, mpirun

SIZE, MARGIN, ELEMENT = (6576, 4384), 330, 40
SMOKE_SIZE, SMOKE_MARGIN = (640, 480), 60
"""Of the images, of what lies beside the mesh, and of its elements, pixels."""

LARGEST = 300.0
"""Displacement of the mesh's corners by the rotation about its centre, pixels; in a smoke run as the images' width."""

NOISE, RIGHT_PX = 2.0, 0.3
"""Standard deviation, grey levels, and the largest error of a node, pixels, of a field that counts as right."""

MOST_SECONDS = 2.0
MOST_TIMES_BEFORE = 1.2

BEFORE = "73864c3"
"""Commit whose start was a translation and a pyramid alone."""

N_REPEATS = 5
"""Runs of each, the two sources in turn; the quickest counts, which others on the machine have disturbed least."""

SUFFICED = {
    "a shift of (47.3, -31.6) px": (0.0, 0.0, 0.0, 0.0),
    "the same with strains of 0.3 and -0.1 %": (0.003, 0.0, 0.0, -0.001),
}
"""Pairs that the start before was enough for: du_x/dx, du_x/dy, du_y/dx, du_y/dy."""

SHIFT = (47.3, -31.6)

JOB = ROOT / "accept" / "support" / "start_job.py"


@dataclass(frozen=True)
class Started:
    """What a run came to.

    Attributes
    ----------
    wall : float
        Seconds of the start, the slowest rank's.
    busy : float
        CPU seconds of the start without waiting for other ranks, the busiest rank's.
    largest : float
        Error of the node that is farthest off, pixels.
    """

    wall: float
    busy: float
    largest: float


@dataclass(frozen=True)
class LargePair:
    """A pair on disk and what is measured on it.

    Attributes
    ----------
    case : Path
        The case file, beside the images and their truth.
    n_pixels : int
        Of an image.
    """

    case: Path
    n_pixels: int

    def run(self, n_ranks: int, source: Path) -> Started:
        """Measure on some ranks with a source's code, and compare with the truth."""
        printed = mpirun(n_ranks, sys.executable, "-m", "mpi4py", str(JOB), str(self.case),
                         changes={"PYTHONPATH": str(source / "src")})
        started = Started(**json.loads(printed))
        append_result("start_runs", {"case": self.case.parent.name, "ranks": n_ranks, "source": source.name,
                                     **asdict(started)})
        return started


def _make_pair(scale: Scale, name: str, gradient: Sequence[float], shift: tuple[float, float]) -> LargePair:
    """Draw a pair unless it is there already."""
    (width, height), margin = (SMOKE_SIZE, SMOKE_MARGIN) if scale.smoke else (SIZE, MARGIN)
    folder = images("affine", "--size", f"{width}x{height}", "--noise", str(NOISE), "--seed", "3",
                    "--gradient", *(repr(float(value)) for value in gradient), "--vector", *map(repr, shift),
                    folder=scale.folder(f"large_{name}"))
    case = folder / "case.toml"
    region = [margin, margin, width - margin, height - margin]
    case.write_text('[images]\nreference = "reference.tif"\ndeformed = "deformed.tif"\n'
                    f'[mesh.structured]\nregion = {region}\nelement_size = {ELEMENT}\n'
                    '[output]\nfile = "result.vtkhdf"\n', encoding="utf-8")
    return LargePair(case, width * height)


def measure_turned(scale: Scale) -> list[Row]:
    """Measure a rotation whose largest displacement is 300 px."""
    (width, height), margin = (SMOKE_SIZE, SMOKE_MARGIN) if scale.smoke else (SIZE, MARGIN)
    largest = LARGEST * width / SIZE[0]
    radius = float(np.hypot(width / 2 - margin, height / 2 - margin))
    degrees = float(np.rad2deg(2 * np.arcsin(largest / 2 / radius)))
    pair = _make_pair(scale, "turned", make_rotation(degrees).ravel().tolist(), (0.0, 0.0))
    # Kernels are compiled once, and kept.
    pair.run(1, ROOT)
    runs = {n_ranks: [pair.run(n_ranks, ROOT) for _ in range(1 if scale.smoke else N_REPEATS)] for n_ranks in (1, 2)}
    told = [f"{min(run.wall for run in of_ranks):.2f} s ({min(run.busy for run in of_ranks):.2f} CPU s of the busiest)"
            for of_ranks in runs.values()]
    off = max(run.largest for of_ranks in runs.values() for run in of_ranks)
    seconds = min(run.wall for run in runs[2])
    return [Row(f"{pair.n_pixels / 1e6:.0f} Mpx, rotation by {degrees:.1f} degrees, displacements to {largest:.0f} px, "
                f"noise of {NOISE:g} grey levels, {ELEMENT}-px elements",
                f"start takes at most {MOST_SECONDS:g} s on 2 ranks; no node off by more than {RIGHT_PX} px",
                f"on 1 rank {told[0]}; on 2 ranks {told[1]}; largest error {off:.3f} px",
                seconds <= MOST_SECONDS and off <= RIGHT_PX, judged_small=False)]


def measure_sufficed(scale: Scale) -> list[Row]:
    """Compare the start with the one before, where that was enough."""
    before = ROOT if scale.smoke else checkout_before(BEFORE)
    return [_compare(what, _make_pair(scale, f"shifted_{number}", gradient, SHIFT), before, scale)
            for number, (what, gradient) in enumerate(list(SUFFICED.items())[:1 if scale.smoke else None])]


def _compare(what: str, pair: LargePair, before: Path, scale: Scale) -> Row:
    """CPU seconds of the busiest rank with both sources, on 1 and 2 ranks."""
    told, holds = [], True
    for n_ranks in (1, 2):
        for source in () if scale.smoke else (before, ROOT):
            pair.run(n_ranks, source)
        both = [(pair.run(n_ranks, before), pair.run(n_ranks, ROOT)) for _ in range(1 if scale.smoke else N_REPEATS)]
        then, now = (min(runs[k].busy for runs in both) for k in (0, 1))
        walls = [min(runs[k].wall for runs in both) for k in (0, 1)]
        off = max(run.largest for runs in both for run in runs)
        holds &= now <= MOST_TIMES_BEFORE * then and off <= RIGHT_PX
        told.append(f"on {n_ranks} rank{'s' * (n_ranks > 1)} {now:.2f} CPU s, {now / then:.2f} times the {then:.2f} s "
                    f"before ({walls[1]:.2f} and {walls[0]:.2f} s of wall time); largest error {off:.3f} px")
    return Row(f"{pair.n_pixels / 1e6:.0f} Mpx, {what}, noise of {NOISE:g} grey levels, {ELEMENT}-px elements",
               f"start takes the busiest rank at most {MOST_TIMES_BEFORE:g} times the CPU time of that of commit "
               f"{BEFORE}; no node off by more than {RIGHT_PX} px", "; ".join(told), holds, judged_small=False)

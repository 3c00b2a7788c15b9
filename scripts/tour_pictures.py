"""Pictures of the README's tour, drawn by the tour's own run: make docs keeps those in docs/pictures up to date.

Usage: python scripts/tour_pictures.py [folder for all files of the run, a temporary one by default].
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures"
KINDS = ("partition", "deformed", "strain", "residual", "krylov")

SHARE, N_COLOURS = 2 / 3, 200
"""Of a picture's size that is kept, and colours of large ones; larger values make larger files."""

LARGEST_BYTES = 250_000
"""Of a picture that keeps all its colours; a larger value makes larger clones."""

SAME_GREY = 0.5
"""Mean difference of pixels, grey levels, up to which a picture counts as the one that is there: another processor
rounds otherwise, and every other file would be a change to commit."""


@cache
def draw_tour(folder: Path | None = None) -> list[Path]:
    """Run the tour and bring its pictures up to date; once a process, however often a site is built.

    Parameters
    ----------
    folder : Path, optional
        For all files of the run.

    Returns
    -------
    list of Path
        Pictures that were replaced.
    """
    if folder is None:
        with tempfile.TemporaryDirectory() as temporary:
            return draw_tour(Path(temporary))
    _run_tour(folder)
    replaced = []
    for kind in KINDS:
        drawn, kept = folder / "pictures" / f"result.{kind}.png", PICTURES / f"{kind}.png"
        small = folder / f"{kind}.png"
        shrink(drawn, small)
        if not is_same(small, kept):
            shutil.copyfile(small, kept)
            replaced.append(kept)
    return replaced


def _run_tour(folder: Path) -> None:
    """Run examples/demo/run.sh, which is the tour; its output is shown where it fails."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    command = ["bash", "-c", '. "$0" && exec bash "$1" "$2"', str(ROOT / "scripts" / "mpi_env.sh"),
               str(ROOT / "examples" / "demo" / "run.sh"), str(folder)]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "PATH": path}, text=True, capture_output=True,
                          check=False)
    if done.returncode:
        raise RuntimeError(f"the tour does not run, so its pictures cannot be drawn:\n{done.stdout}{done.stderr}")


def shrink(picture: Path, small: Path) -> None:
    """Write a picture as small as every clone of the repository should carry.

    Parameters
    ----------
    picture, small : Path
        PNG files.
    """
    with Image.open(picture) as whole:
        height = round(whole.height * SHARE)
        reduced = whole.convert("RGB").resize((round(whole.width * SHARE), height), Image.Resampling.LANCZOS)
        reduced.save(small, optimize=True)
        if small.stat().st_size > LARGEST_BYTES:
            reduced.quantize(N_COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(small, optimize=True)


def is_same(drawn: Path, kept: Path) -> bool:
    """Tell whether two pictures look the same.

    Parameters
    ----------
    drawn, kept : Path
        PNG files; the second may be missing.

    Returns
    -------
    bool
        Whether they have one size and differ by less than SAME_GREY on average.
    """
    one, other = cv2.imread(str(drawn)), cv2.imread(str(kept)) if kept.is_file() else None
    if other is None or one.shape != other.shape:
        return False
    return float(np.abs(one.astype(float) - other.astype(float)).mean()) < SAME_GREY


if __name__ == "__main__":
    for path in draw_tour(Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else None):
        print(path)

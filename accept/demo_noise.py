"""Is the demo's error the noise floor: Kirsch field with noise, against sigma^2 A^-1 M A^-1."""

from __future__ import annotations

import re
import subprocess

import numpy as np

from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ROOT, ddic_run, environment, images
from ddic.io.result_reader import read_result
from ddic.synth.truth import load_truth

MOST_FLOORS = 1.3
"""Noise floors that the error may have beside the interpolation error."""


def measure(scale: Scale) -> list[Row]:
    """Run the demo as a user does, and the same field without noise for the interpolation error.

    Parameters
    ----------
    scale : Scale
        A smoke run does the same: the demo is small.

    Returns
    -------
    list of Row
        One row.
    """
    folder = scale.folder("demo")
    done = subprocess.run(["bash", "examples/demo/run.sh", str(folder)], cwd=ROOT, text=True, capture_output=True,
                          env=environment(), check=False)
    if done.returncode != 0:
        raise RuntimeError(f"the demo ended with exit code {done.returncode}:\n{done.stderr[-2000:]}")
    rms = _number_after(r"known field: ([\d.]+) px", done.stdout)
    floor = _number_after(r"in both images: ([\d.]+) px", done.stdout)
    clean = images("kirsch", "--size", "1000x1000", "--strain", "0.005", "--radius", "100", "--seed", "1",
                   folder=scale.folder("demo_clean") / "images")
    text = (ROOT / "examples" / "demo" / "case.toml").read_text(encoding="utf-8").split("[output]")[0]
    ddic_run(text, clean.parent, 2)
    result = read_result(clean.parent / "result.vtkhdf")
    error = result.displacement - load_truth(clean / "truth.json").displacement(result.mesh.nodes)
    interpolation = float(np.sqrt((error**2).mean()))
    bound = MOST_FLOORS * floor + interpolation
    return [Row("demo (Kirsch, noise): RMS error beside the noise floor of sigma^2 A^-1 M A^-1",
                f"<= {MOST_FLOORS} x floor + interpolation error",
                f"{rms:.5f} px <= {MOST_FLOORS} x {floor:.5f} + {interpolation:.5f} = {bound:.5f} px", rms <= bound)]


def _number_after(pattern: str, text: str) -> float:
    """Number that a pattern captures in what the demo printed."""
    found = re.search(pattern, text)
    if found is None:
        raise RuntimeError(f"the demo did not print {pattern}:\n{text}")
    return float(found.group(1))

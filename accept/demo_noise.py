"""Is the demo's error the noise floor: Kirsch field with noise, against sigma^2 A^-1 M A^-1."""

from __future__ import annotations

import re
import subprocess

import numpy as np
from bench.support.rows import Row, main
from bench.support.runs import DATA, ROOT, ddic_run, images

from ddic.io.result_reader import read_result
from ddic.synth.truth import load_truth


def measure() -> list[Row]:
    """The demo as a user runs it, and the same field without noise for the interpolation error."""
    folder = DATA / "demo"
    done = subprocess.run(["bash", "examples/demo/run.sh", str(folder)], cwd=ROOT, text=True, capture_output=True,
                          check=True)
    rms = _number(r"known field: ([\d.]+) px", done.stdout)
    floor = _number(r"in both images: ([\d.]+) px", done.stdout)
    clean = images("kirsch", "--size", "1000x1000", "--strain", "0.005", "--radius", "100", "--seed", "1",
                   folder=DATA / "demo_clean" / "images")
    text = (ROOT / "examples" / "demo" / "case.toml").read_text(encoding="utf-8").split("[output]")[0]
    ddic_run(text, clean.parent, 2)
    result = read_result(clean.parent / "result.vtkhdf")
    error = result.displacement - load_truth(clean / "truth.json").displacement(result.mesh.nodes)
    interpolation = float(np.sqrt((error**2).mean()))
    bound = 1.3 * floor + interpolation
    return [Row("demo (Kirsch, noise): RMS error beside the noise floor of sigma^2 A^-1 M A^-1",
                "<= 1.3 x floor + interpolation error",
                f"{rms:.5f} px <= 1.3 x {floor:.5f} + {interpolation:.5f} = {bound:.5f} px", rms <= bound)]


def _number(pattern: str, text: str) -> float:
    found = re.search(pattern, text)
    if found is None:
        raise RuntimeError(f"the demo did not print {pattern}:\n{text}")
    return float(found.group(1))


if __name__ == "__main__":
    main("demo_noise", measure)

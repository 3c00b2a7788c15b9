"""The demo's pair saved as JPEG: how much of the error its compression adds."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import tifffile

from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ROOT, ddic_run, images
from ddic.io.result_reader import read_result
from ddic.synth.truth import load_truth

QUALITIES = (95, 85, 75)
"""As cameras and programs write them; 95 is OpenCV's default."""

MOST = 1.1
"""RMS error at the first quality over that of the same pair in TIFF."""


def measure_jpeg_pairs(scale: Scale) -> list[Row]:
    """Measure the demo's pair by its own case from TIFF and from JPEG of several qualities.

    Parameters
    ----------
    scale : Scale
        A smoke run takes one quality.

    Returns
    -------
    list of Row
        One row.
    """
    folder = images("kirsch", "--size", "1000x1000", "--strain", "0.005", "--radius", "100", "--noise", "2",
                    "--seed", "1", folder=scale.folder("jpeg") / "images")
    exact = _measure_error(folder, 0)
    ratios = [_measure_error(folder, quality) / exact for quality in (QUALITIES[:1] if scale.smoke else QUALITIES)]
    listed = ", ".join(f"{ratio:.2f} at quality {quality}" for quality, ratio in zip(QUALITIES, ratios, strict=False))
    return [Row("the demo's pair in JPEG: RMS error over that in TIFF", f"<= {MOST} at quality {QUALITIES[0]}",
                f"{listed}; TIFF {exact:.5f} px", ratios[0] <= MOST)]


def _measure_error(original: Path, quality: int) -> float:
    """RMS error per component at the nodes, pixels; quality 0: TIFF."""
    folder = original.parent / (f"quality_{quality}" if quality else "tiff")
    folder.mkdir(exist_ok=True)
    for name in ("reference", "deformed"):
        grey = tifffile.imread(original / f"{name}.tif")
        if quality:
            cv2.imwrite(str(folder / f"{name}.jpg"), grey, [cv2.IMWRITE_JPEG_QUALITY, quality])
        else:
            tifffile.imwrite(folder / f"{name}.tif", grey)
    case = (ROOT / "examples" / "demo" / "case.toml").read_text(encoding="utf-8").split("[output]")[0]
    ddic_run(case.replace('"images/', '"').replace(".tif", ".jpg" if quality else ".tif"), folder, 2)
    result = read_result(folder / "result.vtkhdf")
    error = result.displacement - load_truth(original / "truth.json").displacement(result.mesh.nodes)
    return float(np.sqrt((error**2).mean()))

"""The demo's pair: its error beside the noise floor, and the same pair in other forms of file and as JPEG."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ROOT, ddic_run, environment, images
from ddic.io.result_reader import read_result
from ddic.synth.truth import load_truth

MOST_FLOORS = 1.3
"""Noise floors that the error may have beside the interpolation error."""


def measure_demo_noise(scale: Scale) -> list[Row]:
    """Run the demo as a user does, and the same field without noise for the interpolation error."""
    folder = scale.folder("demo")
    done = subprocess.run(["bash", "examples/demo/run.sh", str(folder)], cwd=ROOT, text=True, capture_output=True,
                          env=environment(), check=False)
    if done.returncode != 0:
        raise RuntimeError(f"the demo ended with exit code {done.returncode}:\n{done.stderr[-2000:]}")
    rms = number_after(r"known field: ([\d.]+) px", done.stdout)
    floor = number_after(r"in both images: ([\d.]+) px", done.stdout)
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


def number_after(pattern: str, text: str) -> float:
    """Number that a pattern captures in what the demo printed."""
    found = re.search(pattern, text)
    if found is None:
        raise RuntimeError(f"the demo did not print {pattern}:\n{text}")
    return float(found.group(1))


SAME_PX = 1e-4
"""Largest difference at any node, pixels."""

SATURATED = (slice(640, 700), slice(300, 360))
"""Rows and columns of the patch that is saturated in both images, hence left out."""

Array = NDArray[Any]


def _write_float(path: Path, grey: Array) -> None:
    tifffile.imwrite(path, (grey / 255).astype(np.float32))


def _write_12_bits_in_16(path: Path, grey: Array) -> None:
    tifffile.imwrite(path, _to_12_bits(grey))


def _write_palette(path: Path, grey: Array) -> None:
    """Numbers in the opposite order of the grey levels that the palette gives them."""
    levels = 257 * np.arange(256)[::-1]
    tifffile.imwrite(path, 255 - grey, photometric="palette", colormap=np.tile(levels, (3, 1)).astype(np.uint16))


def _write_saturated(path: Path, grey: Array) -> None:
    pixels = _to_12_bits(grey)
    pixels[SATURATED] = 4095
    tifffile.imwrite(path, pixels)


def _write_masked(path: Path, grey: Array) -> None:
    """The same pair with a mask, in place of the saturated patch."""
    tifffile.imwrite(path, _to_12_bits(grey))
    mask = np.ones(grey.shape, np.uint8)
    mask[SATURATED] = 0
    tifffile.imwrite(path.with_name("mask.tif"), mask)


def _to_12_bits(grey: Array) -> Array:
    return 16 * grey.astype(np.uint16)


Writer = Callable[[Path, Array], None]
FORMS: dict[str, tuple[Writer, str, str]] = {
    "float image in [0, 1]": (_write_float, "", "as it is"),
    "12 bits in 16": (_write_12_bits_in_16, "", "as it is"),
    "palette of greys": (_write_palette, "", "as it is"),
    "a patch saturated at 4095 in 16 bits": (_write_saturated, "exclude_saturated = true\n", "masked"),
}
"""How a form is written, its keys in the case, and the form that its field must be the same as."""

ORACLES: dict[str, tuple[Writer, str]] = {
    "as it is": (tifffile.imwrite, ""),
    "masked": (_write_masked, 'reference_mask = "mask.tif"\ndeformed_mask = "mask.tif"\n'),
}


def measure_image_forms(scale: Scale) -> list[Row]:
    """Measure the demo's pair in all forms, by its own case."""
    folder = images("kirsch", "--size", "1000x1000", "--strain", "0.005", "--radius", "100", "--noise", "2",
                    "--seed", "1", folder=scale.folder("forms") / "images")
    oracles = {name: _measure(folder, name, write, keys) for name, (write, keys) in ORACLES.items()}
    rows = []
    for name, (write, keys, oracle) in FORMS.items():
        largest = float(np.abs(_measure(folder, name, write, keys) - oracles[oracle]).max())
        beside = "with 8 bits" if oracle == "as it is" else "with masks on the patch"
        rows.append(Row(f"the demo's pair, {name}, beside the same {beside}: largest difference at any node",
                        f"<= {SAME_PX:.0e} px", f"{largest:.1e} px", largest <= SAME_PX))
    return rows


def _measure(original: Path, name: str, write: Writer, keys: str) -> Array:
    """Displacement of the demo's pair in one form, (n_nodes, 2)."""
    folder = original.parent / name.replace(" ", "_").replace(",", "")
    folder.mkdir(exist_ok=True)
    for file in ("reference.tif", "deformed.tif"):
        write(folder / file, tifffile.imread(original / file))
    case = (ROOT / "examples" / "demo" / "case.toml").read_text(encoding="utf-8").split("[output]")[0]
    case = case.replace('"images/', '"').replace("[images]\n", f"[images]\n{keys}")
    ddic_run(case, folder, 2)
    return read_result(folder / "result.vtkhdf").displacement


QUALITIES = (95, 85, 75)
"""As cameras and programs write them; 95 is OpenCV's default."""

MOST = 1.1
"""RMS error at the first quality over that of the same pair in TIFF."""


def measure_jpeg_pairs(scale: Scale) -> list[Row]:
    """Measure the demo's pair by its own case from TIFF and from JPEG of several qualities."""
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

"""The demo's pair in other forms: the grey levels are the same, or as many, hence so is the field."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ROOT, ddic_run, images
from ddic.io.result_reader import read_result

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
    """Measure the demo's pair in all forms, by its own case.

    Parameters
    ----------
    scale : Scale
        A smoke run does the same: the demo is small.

    Returns
    -------
    list of Row
        One for each form.
    """
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

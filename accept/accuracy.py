"""How near is the field to a known one: reference texture and field, 2112 x 2112 px, 16-px Q4."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from bench.support.rows import Row, append_result, main
from bench.support.runs import DATA, ddic_run, images

from ddic.io.result_reader import read_result
from ddic.synth.truth import load_truth

SIZE, MARGIN, ELEMENT = 2112, 32, 16
BOUNDS = {(0, 0): 0.0027, (0, 64): 0.0016, (2, 0): 0.0125, (2, 64): 0.0031}


def case(folder: Path, wavelength: int, degree: int) -> str:
    """The case file's text."""
    regularization = f"[regularization]\ncut_off_wavelength = {wavelength}\n" if wavelength else ""
    return f"""
[images]
reference = "{folder}/reference.tif"
deformed = "{folder}/deformed.tif"
[mesh.structured]
region = [{MARGIN}, {MARGIN}, {SIZE - MARGIN}, {SIZE - MARGIN}]
element_size = {ELEMENT}
[correlation]
spline_degree = {degree}
{regularization}"""


def error_rms(folder: Path, name: str, truth: Path) -> float:
    """RMS error per component at the nodes more than one element from the border, pixels."""
    result = read_result(folder / f"{name}.vtkhdf")
    nodes = result.mesh.nodes
    error = result.displacement - load_truth(truth).displacement(nodes)
    low, high = nodes.min(axis=0) + 1.01 * ELEMENT, nodes.max(axis=0) - 1.01 * ELEMENT
    inner = ((nodes > low) & (nodes < high)).all(axis=1)
    return float(np.sqrt((error[inner] ** 2).mean()))


def measure() -> list[Row]:
    """One row per noise level and cut-off wavelength; both spline degrees are run and printed."""
    rows = []
    for (noise, wavelength), bound in BOUNDS.items():
        folder = images("sinusoidal", "--size", f"{SIZE}x{SIZE}", "--noise", str(noise),
                        folder=DATA / f"reference_field_noise{noise}")
        errors = {}
        for degree in (3, 5):
            name = f"lc{wavelength}_degree{degree}"
            summary = ddic_run(case(folder, wavelength, degree), folder, 2, name)
            errors[degree] = error_rms(folder, name, folder / "truth.json")
            append_result("accuracy_runs", {"noise": noise, "cut_off_wavelength": wavelength, "spline_degree": degree,
                                            "rms_error_px": errors[degree], **summary})
        what = f"l_c = {wavelength} px" if wavelength else "no regularization"
        rows.append(Row(
            f"reference field, 2112 x 2112, 8 bit, 16-px Q4, noise {noise} grey levels, {what}: RMS error",
            f"<= {bound} px with the quintic spline; the cubic's error beside it",
            f"quintic {errors[5]:.5f} px, cubic {errors[3]:.5f} px", errors[5] <= bound))
    return rows


if __name__ == "__main__":
    main("accuracy", measure)

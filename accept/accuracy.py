"""How near is the field to a known one: reference texture and field, 2112 x 2112 px, 16-px Q4."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_run, images
from ddic.io.result_reader import read_result
from ddic.synth.truth import load_truth

SIZE, SMOKE_SIZE = 2112, 256
"""Side of the images, pixels."""

MARGIN, ELEMENT = 32, 16
"""Edge without elements and side of the elements, pixels."""

DEGREES = (3, 5)
"""Degrees of the spline."""

BOUNDS = {(0, 0): 0.0027, (0, 64): 0.0016, (2, 0): 0.0125, (2, 64): 0.0031}
"""RMS error with the quintic spline by noise in grey levels and cut-off wavelength in pixels (0: none), pixels."""


@dataclass(frozen=True)
class Field:
    """A measurement of the reference field.

    Attributes
    ----------
    noise : int
        Standard deviation of the noise of both images, grey levels.
    wavelength : int
        Cut-off wavelength, pixels; 0 without regularization.
    """

    noise: int
    wavelength: int

    @property
    def what(self) -> str:
        """It in words, for a row."""
        gap = f"l_c = {self.wavelength} px" if self.wavelength else "no regularization"
        return ('reference field, 2112 x 2112, 8 bit, 16-px Q4, method = "assembled", '
                f"noise {self.noise} grey levels, {gap}")


def measure_errors(field: Field, scale: Scale) -> dict[int, float]:
    """Measure the reference field with both splines on two ranks.

    Parameters
    ----------
    field : Field
        What is measured.
    scale : Scale
        A smoke run takes small images.

    Returns
    -------
    dict
        RMS error per component by the spline's degree, pixels.
    """
    size = SMOKE_SIZE if scale.smoke else SIZE
    folder = images("sinusoidal", "--size", f"{size}x{size}", "--noise", str(field.noise),
                    folder=scale.folder(f"reference_field_noise{field.noise}"))
    errors = {}
    for degree in DEGREES:
        name = f"lc{field.wavelength}_degree{degree}"
        summary = ddic_run(_case(folder, size, field.wavelength, degree), folder, 2, name)
        errors[degree] = error_rms(folder / f"{name}.vtkhdf", folder / "truth.json")
        append_result("accuracy_runs", {"noise": field.noise, "cut_off_wavelength": field.wavelength,
                                        "spline_degree": degree, "rms_error_px": errors[degree], **summary})
    return errors


def _case(folder: Path, size: int, wavelength: int, degree: int) -> str:
    """Text of the case file."""
    regularization = f"[regularization]\ncut_off_wavelength = {wavelength}\n" if wavelength else ""
    return f"""
[images]
reference = "{folder}/reference.tif"
deformed = "{folder}/deformed.tif"
[mesh.structured]
region = [{MARGIN}, {MARGIN}, {size - MARGIN}, {size - MARGIN}]
element_size = {ELEMENT}
[correlation]
spline_degree = {degree}
[solver]
method = "assembled"
{regularization}"""


def error_rms(result_file: Path, truth: Path) -> float:
    """Compare a result with the truth at the nodes more than one element from the border.

    Parameters
    ----------
    result_file : Path
        What ``ddic run`` wrote.
    truth : Path
        What ``ddic synth`` wrote.

    Returns
    -------
    float
        RMS error per component, pixels.
    """
    result = read_result(result_file)
    nodes = result.mesh.nodes
    error = result.displacement - load_truth(truth).displacement(nodes)
    low = nodes.min(axis=0) + 1.01 * ELEMENT
    high = nodes.max(axis=0) - 1.01 * ELEMENT
    inner = ((nodes > low) & (nodes < high)).all(axis=1)
    return float(np.sqrt((error[inner] ** 2).mean()))


def measure(scale: Scale) -> list[Row]:
    """Measure a row for each noise level and cut-off wavelength; both splines are run and shown.

    Parameters
    ----------
    scale : Scale
        A smoke run takes small images and one row.

    Returns
    -------
    list of Row
        RMS errors.
    """
    rows = []
    for (noise, wavelength), bound in list(BOUNDS.items())[-1 if scale.smoke else 0:]:
        field = Field(noise, wavelength)
        errors = measure_errors(field, scale)
        rows.append(Row(f"{field.what}: RMS error",
                        f"<= {bound} px with the quintic spline; the cubic's error beside it",
                        f"quintic {errors[5]:.5f} px, cubic {errors[3]:.5f} px", errors[5] <= bound))
    return rows

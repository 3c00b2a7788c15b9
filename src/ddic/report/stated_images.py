"""How the images were taken, in the words of the case, and what they are like."""

from __future__ import annotations

import math

import numpy as np

from ddic.images.binned import BLUR_NOTE
from ddic.images.grey_levels import measure_feature_size, measure_grey_levels
from ddic.io import result_schema as schema
from ddic.io.image_file import ImageFile
from ddic.report.gathered import Gathered
from ddic.report.statement import NOT_RECORDED, NOT_STATED, Items

N_WINDOWS = 15
"""Places at which the pattern is looked at, spread over the elements."""

OF_SETUP = (("Specimen", "specimen"), ("Camera", "camera"), ("Lens", "lens"), ("Aperture", "aperture"),
            ("Stand-off distance", "stand_off_distance"), ("Lighting", "lighting"), ("Exposure time", "exposure"),
            ("Image acquisition rate", "image_rate"), ("Patterning technique", "patterning"))
"""What the user alone knows: its name in the report, its key in ``[acquisition]``."""


def list_setup(gathered: Gathered) -> Items:
    """List what the case says of the set-up, in its own words.

    Parameters
    ----------
    gathered : Gathered
        The result and what belongs to it.

    Returns
    -------
    list of (str, str)
        Where the case says nothing, with the key that would.
    """
    section, shape = gathered.get_section("images"), _parse_size(gathered)
    items = [(name, _quote(gathered, key)) for name, key in OF_SETUP]
    size, unit = section.get("pixel_size"), section.get("length_unit", "px")
    scale = view = f"{NOT_STATED}: images.pixel_size" if gathered.case else NOT_RECORDED
    if size:
        scale = f"{size:g} {unit} per px ({1.0 / size:.4g} px per {unit})"
        view = " x ".join(f"{size * side:.4g} {unit}" for side in shape) if shape else NOT_RECORDED
    times = [gathered.get_attribute(schema.TIME, name) for name in ("reference", "deformed")]
    stamps = NOT_RECORDED if None in times else f"{times[0]:g} (reference), {times[1]:g} (deformed)"
    return [*items, ("Image scale", scale), ("Field of view", view), ("Times of the images", stamps)]


def _quote(gathered: Gathered, key: str) -> str:
    """Words of the case about the set-up, or that there are none."""
    missing = f"{NOT_STATED}: acquisition.{key}" if gathered.case else NOT_RECORDED
    return str(gathered.get_section("acquisition").get(key) or missing)


def _parse_size(gathered: Gathered) -> tuple[int, int] | None:
    """Width and height of the images, pixels."""
    text = str(gathered.get_attribute(schema.PROVENANCE, "reference_size") or "")
    parts = text.split("x")
    return (int(parts[0]), int(parts[1])) if len(parts) == 2 else None


def list_images(gathered: Gathered) -> Items:
    """List sizes, grey levels, features and noise of the images, and what was done to them.

    Parameters
    ----------
    gathered : Gathered
        The result and what belongs to it.

    Returns
    -------
    list of (str, str)
        Measured where the images are still there.
    """
    section, shape = gathered.get_section("images"), _parse_size(gathered)
    levels = [(f"Grey levels, {name}", _describe_levels(gathered.images.get(name)))
              for name in ("reference", "deformed")]
    masks = [f"{what} image" for what in ("reference", "deformed") if section.get(f"{what}_mask")]
    return [("Image size", f"{shape[0]} x {shape[1]} px" if shape else NOT_RECORDED), *levels,
            ("Feature size of the pattern", _describe_features(gathered)), ("Image noise", _describe_noise(gathered)),
            ("Masks", " and ".join(masks) or "none" if section else NOT_RECORDED),
            ("Saturated pixels", "left out" if section.get("exclude_saturated") else "used"),
            ("Image processing before ddic", _quote(gathered, "processing")),
            ("Image filtering by ddic", _describe_filtering(gathered))]


def _describe_levels(image: ImageFile | None) -> str:
    if image is None:
        return f"{NOT_RECORDED}: the image is not there"
    levels = measure_grey_levels(image)
    saturated = "none can be" if levels.saturation is None else (
        f"{100 * levels.n_saturated / (image.width * image.height):.3g} %")
    return (f"{image.layout.bits} bit, {levels.lowest:g} to {levels.highest:g}, mean {levels.mean:.4g}, "
            f"RMS gradient {math.sqrt(levels.gradient_energy):.3g} per px; saturated: {saturated}")


def _describe_features(gathered: Gathered) -> str:
    if "reference" not in gathered.images:
        return f"{NOT_RECORDED}: the image is not there"
    centres = gathered.result.mesh.centroids
    shown = centres[np.linspace(0, len(centres) - 1, N_WINDOWS).astype(int)]
    width = measure_feature_size(gathered.images["reference"], shown)
    return f"{width:.3g} px (autocorrelation, full width at half maximum)" if math.isfinite(width) else "none found"


def _describe_noise(gathered: Gathered) -> str:
    """Of an image, grey levels."""
    section, residual = gathered.get_section("images"), gathered.last_residual
    measured = gathered.get_attribute(schema.UNCERTAINTY, "noise_grey")
    if measured is not None:
        return f"{measured:.3g} grey levels ({gathered.get_attribute(schema.UNCERTAINTY, 'noise_origin')})"
    if section.get("noise"):
        return f"{section['noise']:g} grey levels (given in the case)"
    if math.isnan(residual):
        return NOT_RECORDED
    rest = ("images.at_rest is measured with output.uncertainty = true alone" if section.get("at_rest") else
            "no static pair is recorded")
    return f"{residual / math.sqrt(2.0):.3g} grey levels in each image, were the residual all noise; {rest}"


def _describe_filtering(gathered: Gathered) -> str:
    """The interpolating spline, and the reference image blurred like the frame."""
    if not gathered.summary:
        return f"{NOT_RECORDED}: only the summary says whether the reference image was blurred like the deformed one"
    blurs = [note for note in gathered.summary.get("notes", ()) if note.startswith(BLUR_NOTE)]
    return "; ".join(["none but the interpolating spline", *blurs])

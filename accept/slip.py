"""A known slip along a line: continuous elements, and with the line given, by size of the elements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import ddic
from accept.support.opened_pair import (
    ANGLE,
    SIZE,
    SMOKE_SIZE,
    SPECKLE,
    find_field_error,
    find_opening_error,
    mesh_inside,
    render,
    straight_line,
)
from accept.support.settings import MONOLITHIC, describe_settings
from accept.table import Scale
from bench.support.rows import Row, append_result

ELEMENTS, SMOKE_ELEMENTS = (8, 16, 32, 64), (32,)
SLIPS, SMOKE_SLIPS = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9), (0.45,)
"""Sides of the elements and slips along the line, pixels."""

FIELD_PX, SLIP_PX = 6e-4, 1e-3
"""RMS errors of the displacement and of the slip with elements of 64 px."""


@dataclass(frozen=True)
class _Images:
    """Kind of the images: bits a pixel, and the size of the speckles, times the reference size."""

    bits: int = 16
    speckle: float = SPECKLE

    @property
    def what(self) -> str:
        return (f"slip of {SLIPS[0]:g} to {SLIPS[-1]:g} px along a line at {np.rad2deg(ANGLE):.0f} degrees, "
                f"{self.bits} bit, speckle of {self.speckle:g} times the reference size, "
                f"{describe_settings(MONOLITHIC)}")


JUDGED = _Images()
BESIDE = (_Images(bits=8), _Images(speckle=1.0))
"""Images that are reported beside those of the bounds: 8 bits, and the reference speckle."""


@dataclass(frozen=True)
class _Errors:
    """RMS errors by size of the elements, pixels: displacement of continuous and of enriched elements, and slip."""

    elements: tuple[int, ...]
    continuous: list[float]
    enriched: list[float]
    slip: list[float]

    def __str__(self) -> str:
        return "; ".join(f"{element} px: continuous {c:.1e}, enriched {e:.1e}, slip {s:.1e} px" for element, c, e, s in
                         zip(self.elements, self.continuous, self.enriched, self.slip, strict=True))


def measure_slip(scale: Scale) -> list[Row]:
    """Measure a slip along a line at 27 degrees with continuous elements and with the line given.

    Parameters
    ----------
    scale : Scale
        A smoke run takes a small image, one slip and one size of elements.

    Returns
    -------
    list of Row
        Displacement and slip; then the same with other images.
    """
    errors = _measure(scale, JUDGED)
    rises = bool((np.diff(errors.continuous) > 0).all())
    falls = bool((np.diff(errors.enriched) < 0).all())
    largest = errors.elements[-1]
    judged = [Row(f"{JUDGED.what}: RMS error of the displacement with growing elements",
                  f"rises with continuous elements, falls with enriched ones, <= {FIELD_PX} px at {largest} px",
                  str(errors), rises and falls and errors.enriched[-1] <= FIELD_PX),
              Row(f"{JUDGED.what}: RMS error of the slip along the line, {largest}-px elements", f"<= {SLIP_PX} px",
                  f"{errors.slip[-1]:.1e} px", errors.slip[-1] <= SLIP_PX)]
    return judged + [Row(f"{images.what}: RMS errors", "measured", str(_measure(scale, images)), True,
                         judged_small=False) for images in BESIDE]


def _measure(scale: Scale, images: _Images) -> _Errors:
    size = SMOKE_SIZE if scale.smoke else SIZE
    slips, elements = (SMOKE_SLIPS, SMOKE_ELEMENTS) if scale.smoke else (SLIPS, ELEMENTS)
    rms: dict[str, list[float]] = {"continuous": [], "enriched": [], "slip": []}
    for element in elements:
        found: dict[str, list[float]] = {name: [] for name in rms}
        for slip in slips:
            opened = straight_line(size, slip)
            pair = render(opened, size, speckle=images.speckle, bits=images.bits)
            mesh = mesh_inside(size, element)
            continuous = ddic.measure(pair, mesh, options=MONOLITHIC)
            enriched = ddic.measure(pair, mesh, options={
                **MONOLITHIC, "discontinuity": opened.sections("tangential")})
            found["continuous"].append(find_field_error(continuous, opened))
            found["enriched"].append(find_field_error(enriched, opened))
            found["slip"].append(find_opening_error(enriched, opened))
        for name, errors in found.items():
            rms[name].append(float(np.sqrt(np.mean(np.square(errors)))))
    append_result("xdic_runs", {"check": "slip", "bits": images.bits, "speckle": images.speckle,
                                "elements": elements, **rms})
    return _Errors(elements, **rms)

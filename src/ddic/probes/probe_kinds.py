"""What a field is read with: points, lines, extensometers and strain gauges."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError

Array = NDArray[np.float64]
Place = tuple[float, float]

MOST_PLACES = 100_000
"""Places along one line; a larger number makes larger tables."""


@dataclass(frozen=True)
class PointProbe:
    """Displacement and strain at a point.

    Attributes
    ----------
    name : str
        In tables.
    point : (x, y)
        Pixels of the reference image.
    """

    name: str
    point: Place

    def __post_init__(self) -> None:
        _require_finite(self.name, *self.point)


@dataclass(frozen=True)
class LineProbe:
    """Displacement and strain at evenly spaced places along a line.

    Attributes
    ----------
    name : str
        In tables.
    start, end : (x, y)
        Pixels of the reference image.
    spacing : float
        Between places, pixels, or a little less so that both ends are places.
    """

    name: str
    start: Place
    end: Place
    spacing: float = 1.0

    def __post_init__(self) -> None:
        _require_finite(self.name, *self.start, *self.end, self.spacing)
        _require_apart(self.name, self.start, self.end)
        _require_positive(self.name, "spacing", self.spacing)
        if self.length / self.spacing > MOST_PLACES:
            raise InputError(f"{self.name}: {self.length / self.spacing:.3g} places along the line; {MOST_PLACES} are "
                             "the most, choose a larger spacing")

    @property
    def length(self) -> float:
        """Distance of the ends, pixels."""
        return math.dist(self.start, self.end)

    @property
    def direction(self) -> Array:
        """Unit vector from the start to the end, (2,)."""
        return _find_direction(self.start, self.end)


@dataclass(frozen=True)
class Extensometer:
    """Engineering strain (L - L0) / L0 of the distance of two points.

    Attributes
    ----------
    name : str
        In tables.
    start, end : (x, y)
        Its ends, pixels of the reference image.
    """

    name: str
    start: Place
    end: Place

    def __post_init__(self) -> None:
        _require_finite(self.name, *self.start, *self.end)
        _require_apart(self.name, self.start, self.end)

    @property
    def length(self) -> float:
        """Gauge length L0, pixels."""
        return math.dist(self.start, self.end)

    @property
    def direction(self) -> Array:
        """Unit vector from the start to the end, (2,)."""
        return _find_direction(self.start, self.end)


@dataclass(frozen=True)
class StrainGauge:
    """Strain of the plane that fits the displacement over a rectangle best.

    Attributes
    ----------
    name : str
        In tables.
    centre : (x, y)
        Pixels of the reference image.
    length : float
        Of the rectangle along its direction: the gauge length, pixels.
    width : float or None
        Of the rectangle across, pixels; that of a square by default.
    angle : float
        Of the direction, degrees from x towards y, which is clockwise on the screen.
    """

    name: str
    centre: Place
    length: float
    width: float | None = None
    angle: float = 0.0

    def __post_init__(self) -> None:
        _require_finite(self.name, *self.centre, self.length, self.across, self.angle)
        _require_positive(self.name, "length", self.length)
        _require_positive(self.name, "width", self.across)

    @property
    def across(self) -> float:
        """Width of the rectangle, pixels."""
        return self.length if self.width is None else self.width

    @property
    def direction(self) -> Array:
        """Unit vector along the gauge, (2,)."""
        turned = math.radians(self.angle)
        return np.array([math.cos(turned), math.sin(turned)])


Probe = PointProbe | LineProbe | Extensometer | StrainGauge

KINDS = {PointProbe: "point", LineProbe: "line", Extensometer: "extensometer", StrainGauge: "gauge"}
"""Kinds of probe, as files and tables call them."""


def _require_finite(name: str, *numbers: float) -> None:
    if not all(math.isfinite(number) for number in numbers):
        raise InputError(f"{name}: {', '.join(f'{number:g}' for number in numbers)}: finite numbers expected, pixels")


def _require_positive(name: str, key: str, value: float) -> None:
    if not value > 0:
        raise InputError(f"{name}: {key} = {value:g}; a positive number of pixels expected")


def _require_apart(name: str, start: Place, end: Place) -> None:
    if math.dist(start, end) == 0.0:
        raise InputError(f"{name}: both ends are ({start[0]:g}, {start[1]:g}); give two points")


def _find_direction(start: Place, end: Place) -> Array:
    way = np.subtract(end, start)
    return np.asarray(way / np.linalg.norm(way))

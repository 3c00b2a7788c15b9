"""What a field is read with: points, lines, extensometers and strain gauges.

Probes as they are written: in a TOML file, or as numbers between commas.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.io.input_file import as_path
from ddic.io.text_files import parse_toml, read_text

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
class _BetweenEnds:
    """What has two ends, pixels of the reference image."""

    name: str
    start: Place
    end: Place

    def __post_init__(self) -> None:
        _require_finite(self.name, *self.start, *self.end)
        if self.length == 0.0:
            raise InputError(f"{self.name}: both ends are ({self.start[0]:g}, {self.start[1]:g}); give two points")

    @property
    def length(self) -> float:
        """Distance of the ends, pixels."""
        return math.dist(self.start, self.end)

    @property
    def direction(self) -> Array:
        """Unit vector from the start to the end, (2,)."""
        way = np.subtract(self.end, self.start)
        return np.asarray(way / np.linalg.norm(way))


@dataclass(frozen=True)
class LineProbe(_BetweenEnds):
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

    spacing: float = 1.0

    def __post_init__(self) -> None:
        _require_finite(self.name, *self.start, *self.end, self.spacing)
        super().__post_init__()
        _require_positive(self.name, "spacing", self.spacing)
        if self.length / self.spacing > MOST_PLACES:
            raise InputError(f"{self.name}: {self.length / self.spacing:.3g} places along the line; {MOST_PLACES} are "
                             "the most, choose a larger spacing")


@dataclass(frozen=True)
class Extensometer(_BetweenEnds):
    """Engineering strain (L - L0) / L0 of the distance of two points.

    Attributes
    ----------
    name : str
        In tables.
    start, end : (x, y)
        Its ends, pixels of the reference image, whose distance is the gauge length L0.
    """


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


CLASSES: dict[str, type[Probe]] = {name: kind for kind, name in KINDS.items()}

FORMS = {
    "point": ("x,y", 2, 2),
    "line": ("x0,y0,x1,y1[,spacing]", 4, 5),
    "extensometer": ("x0,y0,x1,y1", 4, 4),
    "gauge": ("x,y,length[,angle[,width]]", 3, 5),
}
"""How a probe of each kind is written as numbers, and how many there are, at least and at most."""

PLACES = ("point", "start", "end", "centre")
"""Keys that take [x, y]; all others take a number."""


def load_probes(path: Path | str) -> list[Probe]:
    """Read named probes from a TOML file: sections ``[point.NAME]``, ``[line.NAME]``, ``[gauge.NAME]``, and so on.

    Parameters
    ----------
    path : Path or str
        The file.

    Returns
    -------
    list of Probe
        In the order of the file.

    Raises
    ------
    InputError
        With the file, the key and what is expected.
    """
    path = as_path(path, "file of probes")
    data = parse_toml(read_text(path, "file of probes", "check the path"), path)
    try:
        probes = [_build_probe(kind, name, keys) for kind, named in data.items()
                  for name, keys in _check_kind(kind, named).items()]
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    if not probes:
        raise InputError(f"{path}: holds no probe; give sections such as [point.A] with point = [x, y]")
    names = [probe.name for probe in probes]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InputError(f"{path}: {', '.join(repeated)}: a name of several probes; give each its own")
    return probes


def parse_probe(kind: str, name: str, text: str) -> Probe:
    """Read a probe of a kind from numbers between commas, as FORMS has them; raises InputError for others."""
    form, fewest, most = FORMS[kind]
    try:
        numbers = [float(number) for number in text.split(",")]
    except ValueError:
        numbers = []
    if not fewest <= len(numbers) <= most or not all(map(math.isfinite, numbers)):
        raise InputError(f"--{kind} {text}: {form} expected, numbers in pixels")
    first, rest = (numbers[0], numbers[1]), numbers[2:]
    if kind == "point":
        return PointProbe(name, first)
    if kind == "gauge":
        return StrainGauge(name, first, **dict(zip(("length", "angle", "width"), rest, strict=False)))
    second = (rest[0], rest[1])
    return Extensometer(name, first, second) if kind == "extensometer" else LineProbe(name, first, second, *rest[2:])


def _check_kind(kind: str, named: Any) -> Mapping[str, Any]:
    if kind not in CLASSES:
        raise InputError(f"{kind}: unknown kind of probe; there are {', '.join(CLASSES)}")
    if not isinstance(named, Mapping) or not all(isinstance(keys, Mapping) for keys in named.values()):
        raise InputError(f"[{kind}]: give each probe a name, as in [{kind}.A]")
    return named


def _build_probe(kind: str, name: str, keys: Mapping[str, Any]) -> Probe:
    """A probe of a section, whose keys are the attributes of its class."""
    known = {field.name: field.default is MISSING for field in fields(CLASSES[kind]) if field.name != "name"}
    for key in keys:
        if key not in known:
            raise InputError(f"{kind}.{name}.{key}: unknown key; valid here: {', '.join(known)}")
    missing = [key for key, is_needed in known.items() if is_needed and key not in keys]
    if missing:
        raise InputError(f"{kind}.{name}.{missing[0]}: this key is missing; it has no default")
    return CLASSES[kind](name, **{key: _convert(f"{kind}.{name}.{key}", key, value) for key, value in keys.items()})


def _convert(where: str, key: str, value: Any) -> Any:
    """A place as a pair of numbers, anything else as a number."""
    if key not in PLACES:
        if not _is_number(value):
            raise InputError(f"{where} = {value!r}: expected a number")
        return float(value)
    is_list = isinstance(value, Sequence) and not isinstance(value, str)
    if not is_list or len(value) != 2 or not all(map(_is_number, value)):
        raise InputError(f"{where} = {value!r}: expected [x, y], pixels")
    return float(value[0]), float(value[1])


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)

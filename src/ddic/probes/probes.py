"""Points, lines, extensometers and strain gauges, from a TOML file or numbers between commas, and what they read."""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.errors import InputError, describe_nearest
from ddic.fracture.opening import get_lines
from ddic.io import result_schema as schema
from ddic.io.input_file import as_path
from ddic.io.result_reader import Result
from ddic.io.text_files import parse_toml, read_text
from ddic.kinematics.strain import compute_green_lagrange, compute_hencky, compute_infinitesimal
from ddic.mesh.interpolation import interpolate_located, locate

Place = tuple[float, ...]
"""x and y, or x, y and z in a volume, pixels of the reference image."""

MOST_PLACES = 100_000
"""Places along one line; a larger number makes larger tables."""


@dataclass(frozen=True)
class PointProbe:
    """Displacement and strain at a point.

    Attributes
    ----------
    name : str
        In tables.
    point : (x, y) or (x, y, z)
        Pixels of the reference image.
    """

    name: str
    point: Place

    def __post_init__(self) -> None:
        _require_places(self.name, self.point)

    @property
    def dim(self) -> int:
        """Number of space dimensions."""
        return len(self.point)


@dataclass(frozen=True)
class _BetweenEnds:
    """What has two ends, pixels of the reference image."""

    name: str
    start: Place
    end: Place

    def __post_init__(self) -> None:
        _require_places(self.name, self.start, self.end)
        if self.length == 0.0:
            raise InputError(f"{self.name}: both ends are ({', '.join(f'{number:g}' for number in self.start)}); give "
                             "two points")

    @property
    def dim(self) -> int:
        """Number of space dimensions."""
        return len(self.start)

    @property
    def length(self) -> float:
        """Distance of the ends, pixels."""
        return math.dist(self.start, self.end)

    @property
    def axis(self) -> Array:
        """Unit vector from the start to the end, (dim,)."""
        way = np.subtract(self.end, self.start)
        return np.asarray(way / np.linalg.norm(way))


@dataclass(frozen=True)
class LineProbe(_BetweenEnds):
    """Displacement and strain at evenly spaced places along a line.

    Attributes
    ----------
    name : str
        In tables.
    start, end : (x, y) or (x, y, z)
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
    start, end : (x, y) or (x, y, z)
        Its ends, pixels of the reference image, whose distance is the gauge length L0.
    """


@dataclass(frozen=True)
class StrainGauge:
    """Strain of the linear displacement that fits best over a rectangle, or over a bar of square section in a volume.

    Attributes
    ----------
    name : str
        In tables.
    centre : (x, y) or (x, y, z)
        Pixels of the reference image.
    length : float
        Of the rectangle or the bar along the gauge: the gauge length, pixels.
    width : float or None
        Of the rectangle or the bar across, pixels; that of a square or a cube by default.
    angle : float
        Of a gauge in the plane, degrees from x towards y, which is clockwise on the screen.
    direction : (x, y, z) or None
        Of a gauge in a volume, a vector of any length along it; x by default.
    """

    name: str
    centre: Place
    length: float
    width: float | None = None
    angle: float = 0.0
    direction: Place | None = None

    def __post_init__(self) -> None:
        _require_places(self.name, self.centre, self.centre if self.direction is None else self.direction)
        _require_finite(self.name, *self.centre, self.length, self.across, self.angle)
        _require_positive(self.name, "length", self.length)
        _require_positive(self.name, "width", self.across)
        if self.dim == 2 and self.direction is not None:
            raise InputError(f"{self.name}: direction is of a gauge in a volume; give angle")
        if self.dim == 3 and self.angle:
            raise InputError(f"{self.name}: angle is of a gauge in the plane; give direction, a vector (x, y, z)")
        if self.direction is not None and not any(self.direction):
            raise InputError(f"{self.name}: direction = (0, 0, 0); give a vector along the gauge")

    @property
    def dim(self) -> int:
        """Number of space dimensions."""
        return len(self.centre)

    @property
    def across(self) -> float:
        """Width of the rectangle or the bar, pixels."""
        return self.length if self.width is None else self.width

    @property
    def axis(self) -> Array:
        """Unit vector along the gauge, (dim,)."""
        return np.asarray(self.axes[0])

    @property
    def axes(self) -> Array:
        """Unit vectors along the gauge and across it, (dim, dim).

        In a volume the first one across is as near as can be to the axis, x, y or z, that is farthest from the gauge.
        """
        if self.dim == 2:
            turned = math.radians(self.angle)
            along = np.array([math.cos(turned), math.sin(turned)])
            return np.array([along, [-along[1], along[0]]])
        way = (1.0, 0.0, 0.0) if self.direction is None else self.direction
        along = np.array(way) / math.hypot(*way)
        farthest = np.eye(3)[np.argmin(np.abs(along))]
        across = farthest - along * (along @ farthest)
        across /= np.linalg.norm(across)
        return np.array([along, across, np.cross(along, across)])


Probe = PointProbe | LineProbe | Extensometer | StrainGauge

KINDS = {PointProbe: "point", LineProbe: "line", Extensometer: "extensometer", StrainGauge: "gauge"}
"""Kinds of probe, as files and tables call them."""


def _require_places(name: str, *places: Place) -> None:
    """Refuse places that are not all of two or all of three finite numbers."""
    if {len(place) for place in places} not in ({2}, {3}):
        given = ", ".join(str(tuple(place)) for place in places)
        raise InputError(f"{name}: {given}: (x, y) expected, or (x, y, z) in a volume, pixels")
    _require_finite(name, *(number for place in places for number in place))


def _require_finite(name: str, *numbers: float) -> None:
    if not all(math.isfinite(number) for number in numbers):
        raise InputError(f"{name}: {', '.join(f'{number:g}' for number in numbers)}: finite numbers expected, pixels")


def _require_positive(name: str, key: str, value: float) -> None:
    if not value > 0:
        raise InputError(f"{name}: {key} = {value:g}; a positive number of pixels expected")


CLASSES: dict[str, type[Probe]] = {name: kind for kind, name in KINDS.items()}

FORMS = {
    2: {"point": "x,y", "line": "x0,y0,x1,y1[,spacing]", "extensometer": "x0,y0,x1,y1",
        "gauge": "x,y,length[,angle[,width]]"},
    3: {"point": "x,y,z", "line": "x0,y0,z0,x1,y1,z1[,spacing]", "extensometer": "x0,y0,z0,x1,y1,z1",
        "gauge": "x,y,z,length[,dx,dy,dz[,width]]"},
}
"""How a probe of each kind is written as numbers, in the plane and in a volume."""

PLACES = ("point", "start", "end", "centre", "direction")
"""Keys that take [x, y] or [x, y, z]; all others take a number."""


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
    probes = parse_probes(read_text(path, "file of probes", "check the path"), path)
    if not probes:
        raise InputError(f"{path}: holds no probe; give sections such as [point.A] with point = [x, y]")
    return probes


def parse_probes(text: str, path: Path) -> list[Probe]:
    """Read the text of a file of probes, which may hold none; ``path`` names it in messages."""
    data = parse_toml(text, path)
    try:
        probes = [_build_probe(kind, name, keys) for kind, named in data.items()
                  for name, keys in _check_kind(kind, named).items()]
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    names = [probe.name for probe in probes]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InputError(f"{path}: {', '.join(repeated)}: a name of several probes; give each its own")
    return probes


def format_probe(probe: Probe) -> str:
    """Write a probe as the section of a file of probes that ``load_probes`` reads, with all digits."""
    is_plain = re.fullmatch(r"[A-Za-z0-9_-]+", probe.name)
    name = probe.name if is_plain else json.dumps(probe.name, ensure_ascii=False)
    lines = [f"[{KINDS[type(probe)]}.{name}]"]
    for field in fields(probe):
        value = getattr(probe, field.name)
        if field.name == "name" or value is None or value == field.default:
            continue
        # All digits, and 16 for 16.0.
        lines.append(f"{field.name} = {re.sub(r'[.]0(?=[],]|$)', '', json.dumps(value))}")
    return "\n".join(lines) + "\n"


def parse_probe(kind: str, name: str, text: str, dim: int = 2) -> Probe:
    """Read a probe of a kind from numbers between commas, as FORMS has them; raises InputError for others."""
    form = FORMS[dim][kind]
    try:
        numbers = [float(number) for number in text.split(",")]
    except ValueError:
        numbers = []
    n_commas = accumulate(part.count(",") for part in form.split("["))
    if len(numbers) - 1 not in n_commas or not all(map(math.isfinite, numbers)):
        of_volume = " of a volume" if dim == 3 else ""
        raise InputError(f"--{kind} {text}: {form} expected{of_volume}, numbers in pixels")
    keys = [field.name for field in fields(CLASSES[kind]) if field.name != "name"]
    if kind == "gauge":
        keys = ["centre", "length", "angle" if dim == 2 else "direction", "width"]
    given: dict[str, Any] = {}
    while numbers:
        key = keys.pop(0)
        n_numbers = dim if key in PLACES else 1
        given[key] = tuple(numbers[:n_numbers]) if key in PLACES else numbers[0]
        numbers = numbers[n_numbers:]
    return CLASSES[kind](name, **given)


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
            raise InputError(f"{kind}.{name}.{key}: unknown key; {describe_nearest(key, list(known))}")
    missing = [key for key, is_needed in known.items() if is_needed and key not in keys]
    if missing:
        raise InputError(f"{kind}.{name}.{missing[0]}: this key is missing; it has no default")
    return CLASSES[kind](name, **{key: _convert(f"{kind}.{name}.{key}", key, value) for key, value in keys.items()})


def _convert(where: str, key: str, value: Any) -> Any:
    """A place as two or three numbers, anything else as a number."""
    if key not in PLACES:
        if not _is_number(value):
            raise InputError(f"{where} = {value!r}: expected a number")
        return float(value)
    is_list = isinstance(value, Sequence) and not isinstance(value, str)
    if not is_list or len(value) not in (2, 3) or not all(map(_is_number, value)):
        raise InputError(f"{where} = {value!r}: expected [x, y], or [x, y, z] in a volume, pixels")
    return tuple(map(float, value))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


Measure = Literal["infinitesimal", "green-lagrange", "hencky"]

MOST_SAMPLES = {2: 64, 3: 40}
"""Places along each side of a strain gauge, in the plane and in a volume, at which its plane is fitted; there is one a
pixel of small ones. More change the plane by less than a thousandth, and take longer. A gauge of as many elements a
side, or more, has more noise than is predicted."""

FEWEST_SAMPLES = 4
"""The least number of them, for gauges of a few pixels."""


@dataclass(frozen=True, eq=False)
class Reading:
    """What a probe reads on one result, at one place or, of a line, at many.

    Attributes
    ----------
    probe : Probe
        What read it.
    points : (n, dim) array
        Places, pixels of the reference image: the middle of an extensometer or a gauge.
    distance : (n,) array
        Of the places from the start of a line, pixels; 0 of other probes.
    displacement : (n, dim) array
        Pixels; the mean over a strain gauge, nan of an extensometer.
    strain : (n, n_components) array
        xx, yy, xy, or in a volume xx, yy, zz, xy, yz, xz of the tensor that was asked for; nan of an extensometer.
    along : (n,) array
        Engineering strain along the probe, which no rotation changes; nan of a point, which has no direction.
    note : str
        Why values are missing (nan), or what is doubtful about them; empty where nothing is.
    """

    probe: Probe
    points: Array
    distance: Array
    displacement: Array
    strain: Array
    along: Array
    note: str = ""


def measure_probe(result: Result, probe: Probe, measure: Measure = "infinitesimal") -> Reading:
    """Read a probe on a measured field.

    Parameters
    ----------
    result : Result
        The field.
    probe : Probe
        Where and how.
    measure : {"infinitesimal", "green-lagrange", "hencky"}, optional
        Tensor of the strain.

    Returns
    -------
    Reading
        nan where a probe leaves the mesh or meets nodes that were not measured, with the reason as its note.

    Raises
    ------
    InputError
        Where the probe is of the plane and the result of a volume, or the other way about.
    """
    if isinstance(probe, Extensometer):
        return _read_extensometer(result, probe)
    if isinstance(probe, StrainGauge):
        return _read_gauge(result, probe, measure)
    return _read_places(result, probe, measure)


def list_samples(result: Result, probe: Probe) -> Array:
    """List the places at which a probe asks for the displacement, (n, dim), pixels of the reference image.

    Raises InputError where the result is of another number of dimensions.
    """
    if probe.dim != result.mesh.dim:
        what, letters = ("an image", "x and y") if result.mesh.dim == 2 else ("a volume", "x, y and z")
        raise InputError(f"{probe.name}: a {KINDS[type(probe)]} of {probe.dim} numbers a place, but {result.path.name} "
                         f"is of {what}; give {letters}")
    if isinstance(probe, PointProbe):
        return np.array([probe.point])
    if isinstance(probe, StrainGauge):
        sides = []
        for side in (probe.length, *(probe.across,) * (probe.dim - 1)):
            # The middles of equal parts, from the gauge's centre.
            n = int(np.clip(math.ceil(side), FEWEST_SAMPLES, MOST_SAMPLES[probe.dim]))
            sides.append(side * ((np.arange(n) + 0.5) / n - 0.5))
        local = np.column_stack([grid.ravel() for grid in np.meshgrid(*sides, indexing="ij")])
        steps = (local[:, k, None] * axis for k, axis in enumerate(probe.axes))
        return np.asarray(sum(steps, start=np.array(probe.centre)))
    n_places = 2 if isinstance(probe, Extensometer) else math.ceil(probe.length / probe.spacing - 1e-9) + 1
    share = np.linspace(0.0, 1.0, n_places)[:, None]
    return np.asarray((1.0 - share) * probe.start + share * np.asarray(probe.end))


def _read_places(result: Result, probe: PointProbe | LineProbe, measure: Measure) -> Reading:
    """Displacement of the cells, strain as it was recovered at their nodes, interpolated."""
    points, dim = list_samples(result, probe), probe.dim
    located = locate(result.mesh, points)

    def interpolate_strain(name: str) -> Array:
        if name not in result.point_data:
            return np.full((len(points), len(schema.list_components(dim))), np.nan)
        return interpolate_located(result.mesh, schema.pick_components(result.point_data[name], dim), located)

    displacement = result.at(points)
    along = np.full(len(points), np.nan)
    distance = np.zeros(len(points))
    if isinstance(probe, LineProbe):
        distance = np.linspace(0.0, probe.length, len(points))
        # The stretch of a fibre from Green and Lagrange's strain, exactly.
        along = _stretch_fibre(interpolate_strain(schema.NODAL_GREEN_LAGRANGE), probe.axis)
    at_nodes = schema.NODAL_STRAINS[measure]
    lacks_strain = at_nodes not in result.point_data
    note = _describe_places(result, located.cells, displacement,
                            "the result has no strain at nodes: written before schema 1.6" if lacks_strain else "")
    return Reading(probe, points, distance, displacement, interpolate_strain(at_nodes), along, note)


def _stretch_fibre(green_lagrange: Array, axis: Array) -> Array:
    """sqrt(1 + 2 e.E.e) - 1 of a fibre that lay along e, ``axis``; (n, n_components) -> (n,)."""
    e = dict(zip(schema.AXES, axis, strict=False))
    terms = [(1.0 if pair[0] == pair[1] else 2.0) * e[pair[0]] * e[pair[1]] * of_pair
             for pair, of_pair in zip(schema.list_components(len(axis)), green_lagrange.T, strict=True)]
    twice = 2.0 * sum(terms[1:], start=terms[0])
    # The same as the root less 1, which would lose the digits of small strains.
    return np.asarray(twice / (np.sqrt(1.0 + twice) + 1.0))


def _read_extensometer(result: Result, probe: Extensometer) -> Reading:
    """Both ends by the shape functions of their cells."""
    ends, dim = list_samples(result, probe), probe.dim
    u = result.at(ends)
    rest, moved = ends[1] - ends[0], u[1] - u[0]
    # L^2 - L0^2 is computed without the difference of two large numbers.
    growth = float(moved @ (2.0 * rest + moved))
    length = float(np.linalg.norm(rest + moved))
    along = growth / (length + probe.length) / probe.length
    note = _describe_places(result, locate(result.mesh, ends).cells, u)
    return Reading(probe, ends.mean(axis=0)[None], np.zeros(1), np.full((1, dim), np.nan),
                   np.full((1, len(schema.list_components(dim))), np.nan), np.array([along]), note)


def _read_gauge(result: Result, probe: StrainGauge, measure: Measure) -> Reading:
    """The linear displacement that fits best, by least squares over the rectangle or the bar."""
    points = list_samples(result, probe)
    u = result.at(points)
    away = points - np.asarray(probe.centre)
    # The samples lie symmetrically about the centre: the mean and the slopes are found one by one.
    gradient = np.linalg.solve(away.T @ away, away.T @ u).T[None]
    green_lagrange = compute_green_lagrange(gradient)
    along = _stretch_fibre(green_lagrange, probe.axis)
    strain = compute_infinitesimal(gradient) if measure == "infinitesimal" else green_lagrange
    if measure == "hencky" and np.isfinite(strain).all():
        strain = compute_hencky(green_lagrange)
    note = _describe_places(result, locate(result.mesh, points).cells, u, _describe_lines(result, probe))
    return Reading(probe, np.array([probe.centre]), np.zeros(1), u.mean(axis=0)[None], strain, along, note)


def _describe_places(result: Result, cells: IntArray, displacement: Array, more: str = "") -> str:
    """Why displacements are nan at some places or doubtful, and what else there is to say; empty where nothing is."""
    missing = np.isnan(displacement).any(axis=1)
    outside = missing & (cells < 0)
    doubtful = result.cell_data.get(schema.DOUBTFUL, np.zeros(result.mesh.n_cells))[cells[cells >= 0]]
    counts = {
        "outside the mesh or in a hole": outside.sum(),
        "where nothing was measured": (missing & ~outside).sum(),
        # Their residual is that of a wrong displacement.
        "in doubtful cells": np.count_nonzero(doubtful),
    }
    notes = [f"{count} of {len(cells)} places {where}" for where, count in counts.items() if count]
    return "; ".join([*notes, more] if more else notes)


def _describe_lines(result: Result, gauge: StrainGauge) -> str:
    """Whether a line across which the displacement jumps runs through a gauge: a plane fits no jump."""
    for vertices in get_lines(result):
        for start, end in pairwise(vertices):
            n_places = math.ceil(float(np.linalg.norm(end - start))) + 1
            share = np.linspace(0.0, 1.0, n_places)[:, None]
            local = (start + share * (end - start) - gauge.centre) @ gauge.axes.T
            if (np.abs(local) < [0.5 * gauge.length, 0.5 * gauge.across]).all(axis=1).any():
                return "a discontinuity runs through it: no strain; an extensometer measures across"
    return ""

"""The results that a page shows: their frames, fields by name, and what is read at a place."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ddic.arrays import BoolArray
from ddic.errors import InputError
from ddic.io import result_schema as schema
from ddic.io.result_reader import Result, keep_cells, read_result
from ddic.io.series_reader import SeriesResult, is_series_file, read_series
from ddic.mesh.interpolation import CellSearch, interpolate_located, locate
from ddic.mesh.mesh import Mesh
from ddic.page.layers import Overlay
from ddic.plots import canvas, maps
from ddic.plots.kinds import NUMBERS, OF_VOLUMES
from ddic.probes.probes import PointProbe
from ddic.probes.tables import format_number, measure_probes


@dataclass(frozen=True)
class FieldChoice:
    """A field that can be looked at.

    Attributes
    ----------
    kind : str
        Of the figure of ``ddic plot`` that shows it.
    component, number : str
        Of the displacement, and of the strain; empty where the kind has none.
    """

    kind: str
    component: canvas.Component = "magnitude"
    number: str | None = None

    @property
    def name(self) -> str:
        """What the page calls it."""
        part = self.number or ("" if self.kind == "residual" else self.component)
        return f"{self.kind} {part}".strip()

    def find_values(self, result: Result) -> maps.Values | None:
        """Find its values in a result; None where that does not hold them."""
        unit = canvas.find_length_unit(result)
        ways: dict[str, Callable[[], maps.Values]] = {
            "displacement": lambda: maps.list_displacement_panels(result, self.component, unit)[0],
            "strain": lambda: maps.list_strain_panels(result, maps.StrainChoice(number=self.number))[0],
            "sigma": lambda: maps.list_sigma_panels(result, self.component, self.number, unit)[0],
            "bias": lambda: maps.list_bias_panels(result, self.component, unit)[0],
            "residual": lambda: maps.list_residual_panels(result)[0],
        }
        needed = {"displacement": schema.DISPLACEMENT, "strain": schema.NODAL_INFINITESIMAL,
                  "sigma": schema.SIGMA_DISPLACEMENT[0], "bias": schema.REGULARIZATION_BIAS}
        held = result.cell_data if self.kind == "residual" else result.point_data
        return ways[self.kind]() if needed.get(self.kind, schema.RESIDUAL_RMS) in held else None


AXES: tuple[canvas.Component, ...] = ("magnitude", "x", "y")

FIELDS = (
    *(FieldChoice("displacement", component) for component in AXES),
    *(FieldChoice("strain", number=number) for number in NUMBERS if number not in OF_VOLUMES),
    *(FieldChoice("sigma", component) for component in AXES[1:]),
    *(FieldChoice("sigma", number=number) for number in schema.list_components(2)),
    *(FieldChoice("bias", component) for component in AXES),
    FieldChoice("residual"),
)
BY_NAME = {field.name: field for field in FIELDS}


class Frames:
    """The frames of a result file, one of a pair; the one that was asked for last is kept.

    Parameters
    ----------
    path : Path
        The file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.series: SeriesResult | None = read_series(path) if is_series_file(path) else None
        self._number = -1
        self._result = self[0]

    def __len__(self) -> int:
        return 1 if self.series is None else len(self.series)

    def __getitem__(self, number: int) -> Result:
        """The frame of a number, from 0, or the last one where there are fewer."""
        number = min(number, len(self) - 1)
        if number != self._number:
            self._result = read_result(self.path) if self.series is None else self.series[number]
            self._number = number
        return self._result

    def read_all(self) -> Iterator[Result]:
        """Read all frames, one after the other."""
        return iter([self[0]]) if self.series is None else iter(self.series)

    def list_fields(self) -> list[str]:
        """List the fields that can be looked at."""
        return [field.name for field in FIELDS if field.find_values(self[0]) is not None]

    def describe_frame(self, number: int) -> str:
        """Name the frame with its time, and say its verdict."""
        result = self[number]
        time = result.attributes.get(schema.TIME, {}).get("deformed", np.nan)
        verdict = "" if result.verdict is None else f": {result.verdict.describe()}"
        return f"{self.path.name}{self.format_frame(number, ', frame ')}, time {format_number(float(time))}{verdict}"

    def format_frame(self, number: int, before: str) -> str:
        """Give the number of a frame in its series, after a text; nothing of a pair."""
        return "" if self.series is None else f"{before}{self.series.numbers[min(number, len(self) - 1)]}"


def find_image_size(result: Result) -> tuple[int, int]:
    """Find the width and the height of a result's reference image, or of what holds its mesh where it names none."""
    size = str(result.attributes.get(schema.PROVENANCE, {}).get("reference_size", ""))
    width, height = size.split("x") if size else result.mesh.nodes.max(axis=0) + 1.0
    return int(width), int(height)


def measure_difference(values: maps.Values, mesh: Mesh, field: FieldChoice, other: Result) -> maps.Values | None:
    """Subtract the same field of another result, at the nodes or in the middle of the cells; None where it has none."""
    less = field.find_values(other)
    if less is None:
        return None
    at = Overlay(other.mesh, locate(other.mesh, mesh.centroids if values.by_cell else mesh.nodes))
    difference = values.values - at.interpolate(less.values, by_cell=less.by_cell)
    return replace(values, values=difference, label=f"difference of {values.label}")


def move_mesh(result: Result) -> Mesh:
    """The mesh as it lies in the deformed image; cells that were not measured are where they were."""
    moved = np.where(np.isfinite(result.displacement), result.displacement, 0.0)
    return replace(result.mesh, nodes=result.mesh.nodes + moved)


def move_back(result: Result, points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Find where points of the deformed image were in the reference image; raises InputError beside the mesh."""
    located = locate(move_mesh(result), np.array(points))
    places = interpolate_located(result.mesh, result.mesh.nodes, located)
    if np.isnan(places).any():
        raise InputError("outside the mesh: what is seen there was not measured")
    return [(x, y) for x, y in places.tolist()]


def find_hatched(result: Result) -> tuple[BoolArray, BoolArray]:
    """Tell which cells were excluded, and which are doubtful, (n_cells,) each."""
    nothing = np.zeros(result.mesh.n_cells)
    excluded = np.isin(result.cell_data.get(schema.EXCLUDED, nothing), schema.EXCLUDED_STATES)
    return excluded, (result.cell_data.get(schema.DOUBTFUL, nothing) != 0) & ~excluded


def describe_place(result: Result, search: CellSearch, place: tuple[float, float], *, is_moved: bool) -> str:
    """Say in a line what a result says of a place in the image in which its cells lie as in a search."""
    near = keep_cells(result, search.list_near(place))
    try:
        (point,) = move_back(near, [place]) if is_moved else [place]
    except InputError as error:
        return str(error)
    return describe_point(near, *point)


def describe_point(result: Result, x: float, y: float) -> str:
    """Say in a line what a point probe reads, with standard deviations, in the digits of ``ddic probe``."""
    low, high = result.mesh.outlines.find_boxes()
    if not ((low <= (x, y)) & (high >= (x, y))).all(axis=1).any():
        # At once, for the pointer goes on.
        return f"x = {x:.2f}, y = {y:.2f} px: outside the mesh or in a hole"
    record = measure_probes([result], [PointProbe("here", (x, y))])[0]
    size, reading, known = record.unit.size, record.reading, record.metrology
    u_x, u_y = (format_digits(size * value, ".5g") for value in reading.displacement[0])
    xx, yy, xy = (format_digits(value, ".3e") for value in reading.strain[0])
    note = "; ".join(filter(None, (reading.note, known.note)))
    return (f"x = {x:.2f}, y = {y:.2f} px: u_x = {u_x}, u_y = {u_y} "
            f"± {format_digits(size * known.displacement_noise, '.2g')} {record.unit.name}; strain xx = {xx}, "
            f"yy = {yy}, xy = {xy} ± {format_digits(known.strain_noise, '.1e')}" + (f" ({note})" if note else ""))


def format_digits(value: float, how: str) -> str:
    """Write a number in some digits; a dash where there is none."""
    return "-" if np.isnan(value) else format(value, how)

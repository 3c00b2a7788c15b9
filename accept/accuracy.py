"""How near is the field to a known one, and the strain at nodes: the same on all partitions, no worse than of cells.

Reference texture and field, 2112 x 2112 px, 16-px Q4.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_run, images
from ddic.io import result_schema as schema
from ddic.io.result_reader import Result, read_result
from ddic.kinematics.nodal_gradients import recover_gradients
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.synth.fields import DisplacementField
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
    """Measure a row for each noise level and cut-off wavelength; both splines are run and shown."""
    rows = []
    for (noise, wavelength), bound in list(BOUNDS.items())[-1 if scale.smoke else 0:]:
        field = Field(noise, wavelength)
        errors = measure_errors(field, scale)
        rows.append(Row(f"{field.what}: RMS error",
                        f"<= {bound} px with the quintic spline; the cubic's error beside it",
                        f"quintic {errors[5]:.5f} px, cubic {errors[3]:.5f} px", errors[5] <= bound))
    return rows


Array = NDArray[np.float64]

EXACT = 1e-12
"""Error of a linear displacement's gradient: rounding of 100 px over cells of 10."""

RANKS_PX = 1e-9
"""Difference between numbers of ranks: the displacement's own, 1e-8 px at most, over elements of 15 px."""

IN_THE_PLANE = [0, 1, 3]
STEP = 1e-3
"""Pixels over which the known displacement is differentiated."""


def measure_nodal_strain(scale: Scale) -> list[Row]:
    """Measure a plate with a hole on several ranks, and recover linear displacements on a cut mesh."""
    side, radius, size, element = (240, 30, (1, 2), 12) if scale.smoke else (1000, 100, (1, 2, 3, 4), 15)
    folder = images("kirsch", "--size", f"{side}x{side}", "--strain", "0.005", "--radius", str(radius), "--noise", "2",
                    "--seed", "1", folder=scale.folder("impressions") / "plate" / "images").parent
    results = {}
    for n_ranks in size:
        ddic_run(_write_case(side, radius, element), folder, n_ranks, f"ranks_{n_ranks}")
        results[n_ranks] = folder / f"ranks_{n_ranks}.vtkhdf"
    first = results[min(results)]
    return [_measure_linear(), _compare_copies(results[max(results)]), _compare_ranks(results),
            _compare_errors(read_result(first), load_truth(folder / "images" / "truth.json"), (side, radius))]


def _write_case(side: int, radius: int, element: int) -> str:
    middle = (side - 1) / 2
    edge = 0.05 * side
    sides = '"left", "right", "top", "bottom"'
    return (f'[images]\nreference = "images/reference.tif"\ndeformed = "images/deformed.tif"\n'
            f"[mesh.structured]\nregion = [{edge}, {edge}, {side - edge}, {side - edge}]\nelement_size = {element}\n"
            f"circles = [{{ center = [{middle}, {middle}], radius = {radius} }}]\n"
            f'[regularization]\ncut_off_wavelength = {4 * element}\nnot_controlled = [{sides}]\n'
            '[solver]\nmethod = "dual"\nsubdomains = 8\ntolerance = 1e-12\ninexact = false\n'
            "[gauss_newton]\ntolerance = 1e-10\nrms_tolerance = 0\n")


def _measure_linear() -> Row:
    whole = build_structured_mesh((0, 0, 120, 120), 8, circles=[((70.0, 60.0), 22.0)])
    mesh = cut_mesh(whole, [np.array([[-5.0, 33.0], [60.0, 41.0], [101.0, 51.0]])]).mesh
    gradient = np.array([[0.1, -0.2], [0.05, 0.3]])
    error = np.abs(recover_gradients([mesh], [(mesh.nodes @ gradient.T).ravel()], list)[0] - gradient).max()
    return Row("a linear displacement on a mesh with a hole and a line: largest error of its gradient at a node",
               f"<= {EXACT:g}", f"{error:.1e}", bool(error <= EXACT))


def _compare_copies(path: Path) -> Row:
    with h5py.File(path) as file:
        numbers = file[schema.POINT_DATA][schema.GLOBAL_NODE_ID][...]
        values = file[schema.POINT_DATA][schema.NODAL_INFINITESIMAL][...]
        by_cell = file[schema.CELL_DATA][schema.STRAIN_INFINITESIMAL][...]
    first = np.unique(numbers, return_index=True)[1]
    largest = float(np.abs(values - values[first][numbers]).max())
    steps = _measure_steps_of_averages(path, by_cell, numbers)
    return Row("copies of interface nodes: largest difference of their strains", "0",
               f"{largest:g}; that of cells averaged piece by piece is {steps:.1e}", largest == 0.0)


def _measure_steps_of_averages(path: Path, by_cell: Array, numbers: NDArray[np.int64]) -> float:
    """What Cell Data to Point Data makes at interface nodes: the largest difference of copies."""
    with h5py.File(path) as file:
        grid = file[schema.VTKHDF]
        n_points, n_cells = grid["NumberOfPoints"][...], grid["NumberOfCells"][...]
        n_ids, offsets = grid["NumberOfConnectivityIds"][...], grid["Offsets"][...]
        connectivity = grid["Connectivity"][...] + np.repeat(np.cumsum(n_points) - n_points, n_ids)
    counts = np.delete(np.diff(offsets, append=0), np.cumsum(n_cells + 1) - 1)
    cells = np.repeat(np.arange(len(by_cell)), counts)
    weights = np.bincount(connectivity, minlength=len(numbers))
    sums = np.column_stack([np.bincount(connectivity, column[cells], len(numbers)) for column in by_cell.T])
    means = sums / weights[:, None]
    first = np.unique(numbers, return_index=True)[1]
    return float(np.abs(means - means[first][numbers]).max())


def _compare_ranks(results: dict[int, Path]) -> Row:
    fields = {n_ranks: read_result(path).point_data[schema.NODAL_INFINITESIMAL] for n_ranks, path in results.items()}
    one = fields[min(fields)]
    largest = max(float(np.abs(field - one).max()) for field in fields.values())
    return Row(f"strain at nodes on {', '.join(map(str, fields))} ranks: largest difference", f"<= {RANKS_PX:g}",
               f"{largest:.1e}", largest <= RANKS_PX)


def _compare_errors(result: Result, truth: DisplacementField, plate: tuple[int, int]) -> Row:
    side, radius = plate
    middle, nodes = (side - 1) / 2, result.mesh.nodes
    away = nodes - middle
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    # Nodes lie on the edge of the hole, where the known displacement ends: a little outside it has both sides.
    outside = middle + away * np.maximum(1.0, (radius + 2 * STEP) / distance)
    at_nodes = result.point_data[schema.NODAL_INFINITESIMAL][:, IN_THE_PLANE] - _differentiate(truth, outside)
    of_cells = (result.cell_data[schema.STRAIN_INFINITESIMAL][:, IN_THE_PLANE]
                - _differentiate(truth, result.mesh.centroids))
    nodal, cells = (float(np.sqrt((error**2).mean())) for error in (at_nodes, of_cells))
    peak = float(result.point_data[schema.NODAL_INFINITESIMAL][:, 1].max())
    of_cell = float(result.cell_data[schema.STRAIN_INFINITESIMAL][:, 1].max())
    return Row("plate with a hole, noise of 2 grey levels: RMS error of strain at nodes", "<= that of the cells'",
               f"{nodal:.2e}, cells {cells:.2e}; largest strain 0.0150, found {peak:.4f} at a node, {of_cell:.4f} in a "
               "cell",
               nodal <= cells, judged_small=False)


def _differentiate(truth: DisplacementField, points: Array) -> Array:
    """Known strain xx, yy, xy at points, (n, 3)."""
    by_x, by_y = ((truth.displacement(points + step) - truth.displacement(points - step)) / (2 * STEP)
                  for step in (np.array([STEP, 0.0]), np.array([0.0, STEP])))
    return np.column_stack([by_x[:, 0], by_y[:, 1], 0.5 * (by_x[:, 1] + by_y[:, 0])])

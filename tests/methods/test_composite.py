"""A composite's field in equilibrium: its ratios keep it, isotropic ones bend it; one field by all ways."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

import ddic
from ddic.functionals.regularization import Material
from ddic.parallel.team import Team
from ddic.synth.fields import DisplacementField
from support.cases import write_case, write_images
from support.measuring import field_on_one_rank, measure, whole_field
from support.pictures import pair_of

RATIOS = {"young_ratio": 15.0, "shear_ratio": 0.5, "material_angle_degrees": 30.0}
LONG = 200.0
"""Cut-off wavelength, pixels: longer than the region's side."""

SECTION = "[regularization]\ncut_off_wavelength = 48.0\n" + "".join(f"{key} = {RATIOS[key]}\n" for key in RATIOS)
TIGHT = "[gauss_newton]\ntolerance = 1e-10\nrms_tolerance = 0.0\n"
NO_START = "[start]\nrigid = false\npyramid = false\nindependent = false\n"
# As for isotropic material: Gauss-Newton to 1e-10, Krylov to 1e-12.
SAME_PX = 1e-8


@dataclass(frozen=True)
class Bent:
    """u_1 = a (x_2^2 - (G12 / C11) x_1^2): in equilibrium, with axis 1 at 30 degrees."""

    def _split(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        material = Material(0.3, "stress", 15.0, 0.5, np.radians(30.0))
        c11, _, _, g12 = material.moduli
        return (points - 96.0) @ material.axes, material.axes, g12 / c11

    def displacement(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        x, axes, ratio = self._split(points)
        return np.outer(2e-4 * (x[:, 1] ** 2 - ratio * x[:, 0] ** 2), axes[:, 0])

    def gradient(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        x, axes, ratio = self._split(points)
        slopes = 4e-4 * x * [-ratio, 1.0] @ axes.T
        return axes[:, 0][None, :, None] * slopes[:, None, :]


BENT: DisplacementField = Bent()


def _write(folder: Path, more: str) -> Path:
    if MPI.COMM_WORLD.rank == 0:
        write_images(folder, BENT)
        write_case(folder, more)
    MPI.COMM_WORLD.barrier()
    return folder / "case.toml"


def _measure_error(mapping: dict[str, Any], **keys: Any) -> float:
    pair = pair_of(BENT, 192, 8)
    mesh = ddic.structured_mesh((24, 24, 168, 168), 12)
    given: Any = mesh
    if mapping:
        given = (np.column_stack([mesh.nodes[:, 0], 192.0 - mesh.nodes[:, 1]]), mesh.cells[:, ::-1])
    result = ddic.measure((pair.reference, pair.deformed), mesh={"file": given, "mapping": mapping},
                          regularization={"cut_off_wavelength": LONG, **keys})
    error = result.displacement - BENT.displacement(result.mesh.nodes)
    return float(np.sqrt((error**2).mean()))


def test_a_field_in_equilibrium_is_kept_by_its_ratios_and_bent_by_others() -> None:
    # Interpolation by cells of 12 px misses h^2 / 12 of a curvature of 4e-4 / px: 5e-3 px.
    assert _measure_error({}, **RATIOS) <= 6e-3
    # Of up to 1 px, and held to the images along the edges alone.
    assert _measure_error({}) >= 3e-2
    assert _measure_error({}, **{**RATIOS, "material_angle_degrees": -60.0}) >= 3e-2


def test_the_angle_is_that_of_the_image_whatever_the_mesh_is_drawn_in() -> None:
    # A mesh with y up, of the same nodes in the image.
    turned_over = {"y_up": True, "translation": [0.0, 192.0]}
    assert _measure_error(turned_over, **RATIOS) == pytest.approx(_measure_error({}, **RATIOS), rel=1e-6)


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("solver", [
    'method = "dual"\nsubdomains = 8\npreconditioner = "scaled"\n',
    'method = "dual"\nsubdomains = 8\npreconditioner = "two_level"\n',
    'method = "assembled"\n',
], ids=["scaled", "two levels", "assembled"])
def test_every_solver_finds_one_field_on_any_number_of_ranks(shared_path: Path, solver: str) -> None:
    path = _write(shared_path, f"[solver]\ntolerance = 1e-12\n{solver}{TIGHT}{SECTION}")
    field = whole_field(measure(Team(MPI.COMM_WORLD), path))
    path = _write(shared_path, f'[solver]\nmethod = "monolithic"\n{TIGHT}{NO_START}{SECTION}')
    assert np.abs(field - field_on_one_rank(path)).max() <= SAME_PX


@pytest.mark.parametrize("degrees", [0.0, 90.0])
def test_products_of_functions_hold_the_field_of_elements(degrees: float) -> None:
    pair = pair_of(BENT, 192, 8)
    sections: dict[str, Any] = {
        "mesh": {"structured": {"region": [24, 24, 168, 168], "element_size": 8}},
        "regularization": {"cut_off_wavelength": 60, "young_ratio": 4.0, "material_angle_degrees": degrees}}
    separated = ddic.measure((pair.reference, pair.deformed), **sections, pgd={})
    whole = ddic.measure((pair.reference, pair.deformed), **sections)
    inside = (np.abs(whole.mesh.nodes - 96.0) < 60.0).all(axis=1)
    difference = separated.at(whole.mesh.nodes[inside]) - whole.displacement[inside]
    # Corrections end at a thousandth of the field, of 0.5 px RMS.
    assert np.sqrt(np.mean(difference**2)) <= 1e-3
    assert separated.attributes["case"]["eta"] == pytest.approx(whole.attributes["case"]["eta"], rel=1e-5)

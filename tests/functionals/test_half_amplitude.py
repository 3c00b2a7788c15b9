"""The wavelengths that are said to lose half of their amplitude do so."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

import ddic
from ddic.functionals.correlation import read_correlation
from ddic.functionals.regularization import (
    HalfAmplitudes,
    Material,
    assemble_stiffness,
    evaluate_plane_waves,
    find_cut_off_weight,
    find_half_amplitudes,
    measure_gap_energies,
    measure_texture_energies,
)
from ddic.mesh.structured import build_structured_mesh
from ddic.mesh.topology import find_boundary_nodes
from support.pictures import source

MARGIN, SIDE, ELEMENT = 10, 800, 10
MESH = build_structured_mesh((MARGIN, MARGIN, MARGIN + SIDE, MARGIN + SIDE), ELEMENT)


def still(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.0 * points


@pytest.fixture(scope="module")
def hessian() -> sparse.csr_matrix:
    speckle, _ = ddic.make_synthetic_pair(still, (SIDE + 2 * MARGIN, SIDE + 2 * MARGIN), seed=1)
    return read_correlation(MESH, source(speckle.astype(float)), 3).assemble_hessian()


def kept_share(operator: SuperLU, hessian: sparse.csr_matrix, columns: tuple[int, ...], wavelength: float,
               axes: NDArray[np.float64]) -> float:
    """Share of the amplitude that is left of the waves in these columns, away from the edge."""
    waves = evaluate_plane_waves(MESH.nodes, wavelength, axes)[:, columns]
    found = operator.solve(hessian @ waves)
    middle = np.repeat((np.abs(MESH.nodes - MARGIN - SIDE / 2) < SIDE / 2 - 150).all(axis=1), 2)
    return float((found * waves)[middle].sum() / (waves**2)[middle].sum())


@pytest.mark.parametrize("wavelength", [50.0, 80.0, 120.0])
@pytest.mark.parametrize("material", [Material(), Material(0.2, "strain"), Material(0.3, "stress", 3.0, 0.5, 0.5)],
                         ids=["plane stress", "plane strain", "composite"])
def test_half_of_the_amplitude_is_left(hessian: sparse.csr_matrix, wavelength: float, material: Material) -> None:
    interior = np.ones(MESH.n_nodes, dtype=bool)
    interior[find_boundary_nodes(MESH)] = False
    eta = find_cut_off_weight(measure_texture_energies(MESH.nodes, hessian, interior, wavelength, material.axes),
                              measure_gap_energies(MESH, material, interior, wavelength))
    kbar = sparse.diags(np.repeat(interior, 2).astype(float)) @ assemble_stiffness(MESH, material)
    operator = splu((hessian + eta * (kbar.T @ kbar)).tocsc())
    told = find_half_amplitudes(material, wavelength)
    # Columns of axis a along b: (1, 1), (1, 2), (2, 1), (2, 2), two phases each; axis 1 is the composite's stiffer one.
    longitudinal = (0, 1, 6, 7) if material.is_isotropic else (0, 1)
    for length, columns in ((told.longitudinal, longitudinal), (told.shear, (2, 3, 4, 5))):
        # A share of 1 / (1 + (l_h / l)^4) has the slope 1 at l_h: 5 % of the length are 0.05 of it.
        assert kept_share(operator, hessian, columns, length, material.axes) == pytest.approx(0.5, abs=0.05)
        twice = kept_share(operator, hessian, columns, 2 * length, material.axes)
        assert twice == pytest.approx(1 / (1 + 2**-4), abs=0.02)


def test_figures_of_the_documentation() -> None:
    told = find_half_amplitudes(Material(), 1.0)
    assert told.shear == pytest.approx(0.866, abs=1e-3)
    assert told.longitudinal == pytest.approx(1.463, abs=1e-3)
    # A tenth is lost where (l_h / l)^4 = 1 / 9.
    assert told.longitudinal * 9**0.25 == pytest.approx(2.53, abs=0.01)
    assert HalfAmplitudes(86.6, 146.3).describe().startswith("waves of 86.6 px (shear) and 146.3 px (longitudinal)")

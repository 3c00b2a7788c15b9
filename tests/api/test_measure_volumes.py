"""Volumes by ``ddic.measure``: an affine displacement, known everywhere, and what the result and its file say of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ddic
from ddic.io import result_schema as schema
from ddic.io.result_reader import Result
from support.volumes import GRADIENT, cube_mesh, displace, make_pair

SIZE, LOW, HIGH = 40, 4.0, 36.0
COARSE = {"start": {"rigid": False, "features": False, "pyramid": False}}
# Of cubic interpolation on waves of 6 px and more: RMS 0.0012 to 0.0017 px over the nodes, 0.007 px at the worst.
BIAS = 0.01


def measure(output: Path | None = None, **sections: object) -> Result:
    f, g = make_pair(SIZE)
    return ddic.measure((f, g), cube_mesh(LOW, HIGH, 4), output=output, **COARSE, **sections)


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("regularized", [False, True])
def test_an_affine_displacement_and_its_six_strains_are_found(regularized: bool) -> None:
    # Faces of a stretched cube are not free: nothing may be asked of their forces.
    mechanics = {"cut_off_wavelength": 32, "not_controlled": ["boundary"], "edge_wavelength": 0}
    sections = {"regularization": mechanics} if regularized else {}
    result = measure(solver={"subdomains": 2}, **sections)
    assert result.converged
    np.testing.assert_allclose(result.displacement, displace(result.mesh.nodes, SIZE), atol=BIAS)
    strain = 0.5 * (GRADIENT + GRADIENT.T)
    for name, place in schema.list_components(3).items():
        i, j = ("xyz".index(axis) for axis in name)
        of_cells = result.cell_data[schema.STRAIN_INFINITESIMAL][:, place]
        at_nodes = result.point_data[schema.NODAL_INFINITESIMAL][:, place]
        # Errors of nodes 8 px apart.
        np.testing.assert_allclose(of_cells, strain[i, j], atol=BIAS / 8)
        np.testing.assert_allclose(at_nodes, strain[i, j], atol=BIAS / 8)
    green = 0.5 * (GRADIENT + GRADIENT.T + GRADIENT.T @ GRADIENT)
    principal = np.sort(0.5 * np.log(1.0 + 2.0 * np.linalg.eigvalsh(green)))[::-1]
    for name, value in zip(schema.NODAL_PRINCIPAL, principal, strict=True):
        np.testing.assert_allclose(result.point_data[name], value, atol=BIAS / 8)


def test_the_file_is_read_back_by_ddic_and_by_vtk(tmp_path: Path) -> None:
    path = tmp_path / "cube.vtkhdf"
    result = measure(path)
    again = ddic.open(path)
    np.testing.assert_array_equal(again.displacement, result.displacement)
    assert again.mesh.dim == 3
    image = again.residual_image
    assert image is not None
    assert image.shape == (SIZE, SIZE, SIZE)
    assert np.isfinite(image[5:35, 5:35, 5:35]).all()
    assert np.isnan(image[0]).all()
    # VTK's own reader, which orders tensors' components by itself.
    pyvista = pytest.importorskip("pyvista")
    grid = pyvista.read(path)
    assert grid.n_cells == result.mesh.n_cells
    assert set(grid.celltypes) == {12}
    places = np.asarray(grid.point_data[schema.GLOBAL_NODE_ID])
    np.testing.assert_array_equal(grid.point_data[schema.DISPLACEMENT], result.displacement[places])
    volume = grid.compute_cell_sizes()["Volume"]
    np.testing.assert_allclose(volume, 8.0**3)
    shown = pyvista.read(tmp_path / "cube.residual.vtkhdf")
    assert shown.dimensions == (SIZE, SIZE, SIZE)
    np.testing.assert_array_equal(np.asarray(shown.point_data[schema.RESIDUAL]).reshape(image.shape), image)

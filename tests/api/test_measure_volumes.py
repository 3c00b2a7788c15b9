"""Volumes by ``ddic.measure``: an affine displacement, known everywhere, and what the result and its file say of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ddic
from ddic.errors import InputError
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


@pytest.mark.parametrize("hidden", ["the whole surface", "a part of it"])
def test_matching_measures_what_a_mask_leaves(hidden: str) -> None:
    f, g = make_pair(SIZE)
    z, y, x = np.mgrid[:SIZE, :SIZE, :SIZE] - (SIZE - 1) / 2
    seen = x**2 + y**2 + (z**2 if hidden == "the whole surface" else 0) < 12.0**2
    sections = {**COARSE, "regularization": {"cut_off_wavelength": 24}}
    found = [ddic.measure((ddic.Image(f, mask=seen), g), cube_mesh(LOW, HIGH, 4), solver={"method": method}, **sections)
             for method in ("matching", "conjugate_gradient")]
    # Both leave 1e-3 of each linear step, and of the field.
    np.testing.assert_allclose(found[0].displacement, found[1].displacement, atol=1e-2)
    # 50 to 300; nodes without voxels once stood in the way of a thousand.
    assert max(len(residuals) for residuals in found[0].krylov) < 500


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_the_same_volume_twice_is_told(dtype: str) -> None:
    values, noise = make_pair(SIZE)[0], np.random.default_rng(0).standard_normal((2, SIZE, SIZE, SIZE))
    one, other = (np.clip(np.rint(values + of_it), 0, 255).astype(dtype) for of_it in noise)
    same, alike = (ddic.measure(pair, cube_mesh(LOW, HIGH, 4), **COARSE) for pair in ((one, one), (one, other)))
    assert "is it the right file?" in str(same.verdict.reasons)
    assert "is it the right file?" not in str(alike.verdict.reasons)
    # Coefficients of bytes are rounded to a tenth of a grey level.
    assert np.abs(same.displacement).max() < 3e-3


def test_files_are_volumes_where_the_section_says_so(tmp_path: Path) -> None:
    f, g = make_pair(SIZE)
    files = {"reference": tmp_path / "f.npy", "deformed": tmp_path / "g.npy"}
    for path, values in zip(files.values(), (f, g), strict=True):
        np.save(path, values)
    result = ddic.measure(volumes=files, mesh=cube_mesh(LOW, HIGH, 4), **COARSE)
    np.testing.assert_allclose(result.displacement, displace(result.mesh.nodes, SIZE), atol=BIAS)
    with pytest.raises(InputError, match=r"volumes=\{"):
        ddic.measure(tuple(files.values()), cube_mesh(LOW, HIGH, 4), **COARSE)
    with pytest.raises(InputError, match="give volumes, with voxel_size"):
        ddic.measure((f, g), cube_mesh(LOW, HIGH, 4), images={"length_unit": "mm", "pixel_size": 0.1})

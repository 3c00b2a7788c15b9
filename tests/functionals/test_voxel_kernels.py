"""The compiled sums over voxels against the readable ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.functionals.correlation import Correlation, read_correlation
from ddic.images.binned import ArraySource
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.mesh.mesh import Mesh
from support.random_meshes import SEEDS, box_mesh
from support.slow_correlation import readable_kernels_instead

# Grey levels, splines and local coordinates are float32, which has 6e-8 of each: of a spline's values, up to 27 times
# the grey levels of white noise before they are added up, some 1e-6 of the grey levels are left.
ROUNDING = 2e-6
SIZES = (48, 40, 64)
TYPES = {"uint8": np.uint8, "uint16": np.uint16, "float": np.float32}


def noise(seed: int, kind: str) -> NDArray[np.float64]:
    """White noise: the hardest volume for the spline, every tap counts."""
    values = np.random.default_rng(seed).integers(0, 256, SIZES[::-1])
    return np.asarray(values, dtype=TYPES[kind])


def volume(values: NDArray[np.float64], mask: NDArray[np.bool_] | None = None) -> MaskedSource:
    return MaskedSource(ArraySource(Path("memory"), values),
                        None if mask is None else ArraySource(Path("mask"), mask.astype(np.uint8)))


def place(seed: int, cells: str, shape: str) -> Mesh:
    mesh = box_mesh(seed, cells, (2, 2, 2))
    nodes = mesh.nodes if shape == "distorted" else box_mesh(seed, cells, (2, 2, 2), jitter=0.0).nodes
    if shape == "turned":
        nodes = nodes @ np.array([[0.9, -0.3, 0.1], [0.4, 1.0, -0.2], [0.1, 0.2, 0.9]])
    return Mesh(nodes - nodes.min(axis=0) + 9.3, mesh.connectivity, mesh.offsets, mesh.types)


def assert_same_sums(part: Correlation, deformed: DeformedSubImage, q: NDArray[np.float64]) -> None:
    fast, hessians = part.compute_residual(deformed, q, all_kinds=True), part.compute_cell_hessians()
    with readable_kernels_instead():
        anew = replace(part)
        slow, expected = anew.compute_residual(deformed, q, all_kinds=True), anew.compute_cell_hessians()
    np.testing.assert_array_equal(fast.cell_sums.n_pixels, slow.cell_sums.n_pixels)
    # Each sum in units of what its n terms could be at most.
    n = np.maximum(slow.cell_sums.n_pixels, 1.0)
    units = n[:, None] * (255.0 * np.array([[0.0, 1.0, 1.0, 255.0, 255.0, 255.0]]) + 1.0)
    np.testing.assert_allclose(fast.cell_sums.values / units, slow.cell_sums.values / units, atol=ROUNDING)
    cells, steepest = np.arange(part.mesh.n_cells), 255.0
    for gain, offset in ((1.0, 0.0), (0.7, 20.0)):
        forces, wanted = (part.compute_cell_forces(cells, residual, gain, offset) for residual in (fast, slow))
        np.testing.assert_allclose(forces / (255.0 * steepest * n[:, None]), wanted / (255.0 * steepest * n[:, None]),
                                   atol=ROUNDING)
    np.testing.assert_allclose(hessians, expected, atol=ROUNDING * np.abs(expected).max())


@settings(max_examples=15)
@given(seed=SEEDS, cells=st.sampled_from(["Hex8", "Tet4", "both"]),
       shape=st.sampled_from(["box", "turned", "distorted"]), kind=st.sampled_from(list(TYPES)),
       reach=st.sampled_from([0.0, 2.0, 30.0]), f_masked=st.booleans(), g_masked=st.booleans())
def test_sums_equal_the_readable_ones(seed: int, cells: str, shape: str, kind: str, reach: float, f_masked: bool,
                                      g_masked: bool) -> None:
    rng = np.random.default_rng(seed)
    mesh = place(seed % 1000, cells, shape)
    masks = [rng.random(SIZES[::-1]) < 0.98 if is_masked else None for is_masked in (f_masked, g_masked)]
    part = read_correlation(mesh, volume(noise(seed, kind), masks[0]), 3)
    deformed = DeformedSubImage(volume(noise(seed + 1, kind), masks[1]), 3)
    # Where it reaches far, voxels leave the volume, and neighbours part.
    assert_same_sums(part, deformed, rng.uniform(-reach, reach, mesh.n_dofs))


def test_a_light_is_subtracted_from_grey_levels_and_left_out_of_the_gradient() -> None:
    rng = np.random.default_rng(7)
    mesh = place(7, "both", "turned")
    part = read_correlation(mesh, volume(noise(7, "uint8")), 3)
    # As where cells end: it is known inside them only, and would be a step.
    light = rng.uniform(-50.0, 50.0, part.reference.window.shape).astype(np.float32)
    lit = replace(part, reference=part.reference.correct_light(light))
    np.testing.assert_allclose(lit.reference.grey_levels, part.reference.grey_levels - light, rtol=1e-6)
    np.testing.assert_array_equal(lit.compute_cell_hessians(), part.compute_cell_hessians())
    assert_same_sums(lit, DeformedSubImage(volume(noise(8, "uint8")), 3), rng.uniform(-2.0, 2.0, mesh.n_dofs))


@pytest.mark.parametrize("cells", ["Hex8", "Tet4"])
def test_residual_volumes_equal_the_readable_ones_and_bands_the_whole(cells: str) -> None:
    rng = np.random.default_rng(5)
    mesh = place(5, cells, "distorted")
    part = read_correlation(mesh, volume(noise(5, "uint8"), rng.random(SIZES[::-1]) < 0.99), 3)
    deformed = DeformedSubImage(volume(noise(6, "uint8")), 3)
    q = rng.uniform(-2.0, 2.0, mesh.n_dofs)
    gain, offset = rng.uniform(0.8, 1.2, mesh.n_cells), rng.uniform(-5.0, 5.0, mesh.n_cells)
    found = part.compute_residual_image(deformed, q, gain, offset)
    with readable_kernels_instead():
        expected = replace(part).compute_residual_image(deformed, q, gain, offset)
    np.testing.assert_allclose(found, expected, atol=255 * 10 * ROUNDING)
    together = np.full(found.shape, np.nan, np.float32)
    bands = part.split_bands(8)
    for band, image in zip(bands, part.compute_residual_bands(deformed, q, bands, gain, offset), strict=True):
        target = together[part.reference.window.locate(band.window)]
        np.copyto(target, image, where=~np.isnan(image))
    np.testing.assert_array_equal(together, found)

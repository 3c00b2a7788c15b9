"""The box of pixels about a cell."""

from __future__ import annotations

import numpy as np

from ddic.functionals.correlation import read_correlation
from ddic.functionals.spoilt_pixels import cut_patches
from ddic.functionals.view import View
from ddic.images.sub_image import DeformedSubImage
from ddic.kinematics.nodal import NodalKinematics
from ddic.mesh.cell_type import T3
from ddic.mesh.mesh import build_mesh
from support.pictures import source

NODES = np.array([[5.3, 4.2], [14.6, 6.1], [8.0, 13.7], [20.0, 18.0]])
MESH = build_mesh(NODES, [(T3, np.array([[0, 1, 2], [1, 3, 2]]))])


def test_a_patch_holds_the_cells_pixels_of_both_images() -> None:
    f = np.random.default_rng(2).uniform(20, 200, (30, 40))
    g = np.random.default_rng(3).uniform(20, 200, (30, 40))
    hidden = (9, 9)
    is_shown = np.ones(f.shape, dtype=bool)
    is_shown[hidden[1], hidden[0]] = False
    correlation = read_correlation(MESH, source(f, is_shown), 3)
    view = View(correlation, NodalKinematics(MESH, np.arange(MESH.n_dofs))).open_frame(DeformedSubImage(source(g), 3))
    q = np.random.default_rng(4).uniform(-2, 2, MESH.n_dofs)
    patches = list(cut_patches(view, q, np.array([1, 0]), (1.1, -3.0)))
    assert [cell for cell, _, _ in patches] == [1, 0]
    assert list(cut_patches(view, q, np.zeros(0, np.int64), (1.1, -3.0))) == []
    _, box, patch = patches[1]
    # Pixel centres left of all three sides of the first triangle.
    x, y = np.meshgrid(np.arange(box.x0, box.x1), np.arange(box.y0, box.y1))
    own = np.ones(x.shape, dtype=bool)
    for (ax, ay), (bx, by) in zip(NODES[:3], NODES[[1, 2, 0]], strict=True):
        own &= (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0
    assert own.any(axis=0).all()
    assert own.any(axis=1).all()
    assert own.sum() == correlation.raster.pixel_counts[0]
    window, residual = correlation.reference.window, view.compute_residual_image(q)
    r = residual[y - window.y0, x - window.x0]
    # What is excluded takes its neighbours along, whose slopes are taken from it.
    np.testing.assert_array_equal(patch.counts, own & np.isfinite(r))
    assert 0 < patch.counts.sum() < own.sum()
    # Images are held in float32: 200 grey levels to 1e-5.
    np.testing.assert_allclose(patch.f[patch.counts], f[y, x][patch.counts], atol=2e-5)
    np.testing.assert_allclose(patch.g[patch.counts], (1.1 * (f[y, x] - r) - 3.0)[patch.counts], atol=5e-5)

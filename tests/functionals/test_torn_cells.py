"""One node that runs away costs its own cells, and no more of the image than it did before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ddic.functionals.correlation import PIXEL_KERNELS, find_torn_cells, read_correlation
from ddic.functionals.pixel_kernels import COMPILED
from ddic.images.sub_image import DeformedSubImage
from ddic.mesh.structured import build_structured_mesh
from ddic.synth.fields import Translation
from support.pictures import pair_of, source

MESH = build_structured_mesh((24.0, 24.0, 168.0, 168.0), 16.0)
PAIR = pair_of(Translation((0.0, 0.0)))
RUNAWAY = 44
"""An inner node, of four cells."""


def _runaway(distance: float) -> np.ndarray:
    q = np.zeros((MESH.n_nodes, 2))
    q[RUNAWAY, 0] = distance
    return q.ravel()


@given(angle=st.floats(-180, 180), stretch=st.floats(0.2, 2.0), shift=st.floats(-1e4, 1e4))
def test_no_rotation_and_no_stretch_of_a_specimen_tears(angle: float, stretch: float, shift: float) -> None:
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    u = MESH.nodes @ (stretch * np.array([[c, -s], [s, c]]) - np.eye(2)) + shift
    assert len(find_torn_cells(MESH, u)) == 0


@pytest.mark.parametrize("distance", [1e2, 1e3, -1e3, 1e9])
def test_runaway_node_tears_its_cells_and_leaves_the_window(distance: float) -> None:
    part = read_correlation(MESH, source(PAIR.reference), 3)
    its_cells = np.flatnonzero((MESH.cells == RUNAWAY).any(axis=1))
    assert len(its_cells) == 4
    q = _runaway(distance)
    np.testing.assert_array_equal(find_torn_cells(MESH, q.reshape(-1, 2)), its_cells)
    still = part.find_displaced_window(np.zeros_like(q))
    assert part.find_displaced_window(q) == still
    deformed = DeformedSubImage(source(PAIR.deformed), 3)
    n_pixels = part.compute_residual(deformed, q).cell_sums.n_pixels
    assert (n_pixels[its_cells] == 0).all()
    assert (np.delete(n_pixels, its_cells) == 256).all()
    assert part.without_hidden(deformed, q).n_usable_pixels == n_pixels.sum()
    # The image is not read again: 1e3 px to the right, the spline of all of it would be.
    assert deformed.get_spline(still).window.n_pixels < 192**2


def test_displacement_that_tears_every_cell_needs_no_image() -> None:
    part = read_correlation(MESH, source(PAIR.reference), 3)
    q = np.random.default_rng(0).uniform(-1e5, 1e5, MESH.n_dofs)
    assert part.find_displaced_window(q).n_pixels == 1
    assert part.compute_residual(DeformedSubImage(source(PAIR.deformed), 3), q).n_pixels == 0


def test_torn_cells_are_not_visited(monkeypatch: pytest.MonkeyPatch) -> None:
    visited: list[int] = []
    sums = COMPILED.residual_sums
    noting = replace(COMPILED, residual_sums=lambda cells, *rest: (visited.extend(cells.order), sums(cells, *rest)))
    monkeypatch.setitem(PIXEL_KERNELS, "bilinear", noting)
    side = 1024
    image = source(np.random.default_rng(0).uniform(0, 255, (side, side)).astype(np.float32))
    mesh = build_structured_mesh((848.0, 848.0, 992.0, 992.0), 16.0)
    part = read_correlation(mesh, image, 3)
    deformed = DeformedSubImage(image, 3)
    n_pixels = part.compute_residual(deformed, _runaway(1e3)).cell_sums.n_pixels
    # They are nowhere in the window that is in memory, 800 rows from the image's edge: reading there once crashed.
    whole = np.flatnonzero(~(mesh.cells == RUNAWAY).any(axis=1))
    assert sorted(visited) == whole.tolist()
    assert (n_pixels[whole] == 256).all()
    residual = part.compute_residual_image(deformed, _runaway(1e3))
    assert np.isfinite(residual).sum() == 256 * len(whole)

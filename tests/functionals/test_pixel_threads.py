"""The number of threads changes no digit of what comes from pixels."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.functionals.correlation import FEWEST, read_correlations
from ddic.images.spline import _BAND_ROWS
from ddic.images.sub_image import DeformedSubImage
from ddic.images.threads import Threads
from ddic.mesh.mesh import Mesh
from ddic.partition.split import split_by_blocks
from support.pictures import source
from support.random_meshes import grid_mesh

WIDTH, HEIGHT = 230, 1310
COLUMNS, ROWS = 30, 210


@cache
def parts_of_mesh(n_parts: int) -> tuple[Mesh, ...]:
    """Some 9000 distorted T3 and Q4 of about 6 px, cut into bands of rows."""
    mesh = grid_mesh(COLUMNS, ROWS, (6.0, 6.0), origin=(25.3, 24.8), cells="mixed", seed=3, jitter=0.2)
    labels = split_by_blocks(mesh, (1, n_parts))
    return tuple(mesh.create_submesh(np.flatnonzero(labels == s))[0] for s in range(n_parts))


@cache
def everything(n_threads: int, n_parts: int, degree: int, masked: bool) -> dict[str, NDArray[Any]]:
    """All that is computed from pixels, by name."""
    rng = np.random.default_rng(5)
    f, g = (rng.integers(0, 256, (HEIGHT, WIDTH)).astype(np.float32) for _ in range(2))
    masks = [rng.random(f.shape) < 0.9 for _ in range(2)] if masked else [None, None]
    threads = Threads(n_threads)
    meshes = parts_of_mesh(n_parts)
    found: dict[str, NDArray[Any]] = {}
    parts = [part for group in read_correlations(meshes, source(f, masks[0]), degree, threads) for part in group]
    for s, part in enumerate(parts):
        deformed = DeformedSubImage(source(g, masks[1]), degree, threads)
        # Some pixels leave the image.
        q = np.random.default_rng(s).uniform(-15, 15, part.mesh.n_dofs)
        residual = part.compute_residual(deformed, q, all_kinds=True)
        gain, offset = residual.cell_sums.fit_gain_and_offset()
        reference, spline = part.reference, deformed.get_spline(part.find_displaced_window(q))
        seen = part.without_hidden(deformed, q)
        assert seen.threads is part.threads is threads
        found |= {f"{name} of part {s}": array for name, array in {
            "f": reference.values, "slopes of f": reference.slopes, "g": spline.coefficients,
            "hessian": part.compute_cell_hessians(), "moments": residual.moments, "sums": residual.cell_sums.values,
            "residual image": part.compute_residual_image(deformed, q, gain, offset),
            "hessian of what is seen": seen.compute_cell_hessians()}.items()}
    return found


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("degree", [3, 5])
@pytest.mark.parametrize("n_parts", [1, 3])
@pytest.mark.parametrize("n_threads", [2, 3])
def test_number_of_threads_changes_no_digit(n_threads: int, n_parts: int, degree: int, masked: bool) -> None:
    # Else no work would be shared out.
    assert min(mesh.n_cells for mesh in parts_of_mesh(n_parts)) > 2 * FEWEST
    assert HEIGHT > 2 * _BAND_ROWS
    expected, found = everything(1, n_parts, degree, masked), everything(n_threads, n_parts, degree, masked)
    assert expected.keys() == found.keys()
    for name, array in expected.items():
        np.testing.assert_array_equal(found[name], array, err_msg=name)
        assert np.isfinite(array).any()

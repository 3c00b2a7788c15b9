"""What of a frame does not show the specimen, found on small regions."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import ddic
from ddic.mesh.cell_type import Q4
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.visibility.exclusions import KEPT, SPOILT, UNSEEN
from support.spoilt import FIELD, MESH, SIDE, clean, hide


def diamond(tip: float, half: float = 48.0, n: int = 6) -> Mesh:
    """A square that stands on its corner: its first and last rows hold no pixel's centre, or one."""
    steps = np.linspace(-half, half, n + 1)
    a, b = np.meshgrid(steps, steps)
    nodes = np.column_stack([(128.3 + (a - b) / 2).ravel(), (tip + half + (a + b) / 2).ravel()])
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    return build_mesh(nodes, {Q4: np.stack([corner, corner + 1, corner + n + 2, corner + n + 1], axis=1)})


@pytest.mark.parametrize("tip", [80.0, 80.25, 80.9])
@pytest.mark.parametrize("end", ["first", "last"])
def test_cells_whose_rows_are_empty_at_a_tip_are_searched(tip: float, end: str) -> None:
    mesh = diamond(tip)
    cell = 0 if end == "first" else mesh.n_cells - 1
    middle = mesh.centroids[cell] + FIELD.displacement(mesh.centroids[cell][None])[0]
    x, y = np.rint(middle).astype(int)
    # A spot of 2 px and what is left out about it are less than half of a cell of 128 px.
    scene = hide((x, y, x + 2, y + 2))
    options = {"regularization": {"cut_off_wavelength": 60}, "correlation": {"grey_correction": "none"}}
    result = ddic.measure(scene.pair, mesh, **options)
    of_clean = ddic.measure(clean().pair, mesh, **options)
    assert np.delete(result.fields["excluded"] == KEPT, cell).all()
    # The tip itself has but the corners of one cell's pixels that are left.
    others = np.setdiff1d(np.arange(mesh.n_nodes), mesh.connectivity.reshape(-1, 4)[cell])
    assert np.abs(result.displacement - of_clean.displacement)[others].max() <= 0.05


def test_a_cell_is_spoilt_from_half_of_its_pixels_on() -> None:
    # The cell from column and row 112 on, by where it goes.
    cell = int(np.abs(MESH.centroids - 120.0).sum(axis=1).argmin())
    low = np.rint(112 + FIELD.displacement(np.full((1, 2), 112.0))[0]).astype(int)
    states = []
    for width in (3, 11):
        # Over the cell's height; 4 px more are left out beside.
        scene = hide((low[0], low[1], low[0] + width, low[1] + 16))
        states.append(ddic.measure(scene.pair, MESH).fields["excluded"])
    assert states[0][cell] == KEPT
    assert states[1][cell] == SPOILT


@pytest.mark.parametrize("regularized", [False, True])
def test_what_the_image_does_not_hold_is_unseen(regularized: bool) -> None:
    columns = 190
    cut = clean().deformed[:, :columns]
    reference = clean().reference
    mask = np.zeros((SIDE, SIDE), dtype=bool)
    mask[:, :columns] = True
    padded = np.zeros_like(reference)
    padded[:, :columns] = cut
    options = {"regularization": {"cut_off_wavelength": 100}} if regularized else {}
    result = ddic.measure((reference, ddic.Image(padded, mask=mask)), MESH, **options)
    states = result.fields["excluded"]
    moved = MESH.nodes + FIELD.displacement(MESH.nodes)
    of_cells = moved[MESH.connectivity.reshape(-1, 4), 0]
    is_out, is_in = of_cells.min(axis=1) > columns + 2, of_cells.max(axis=1) < columns - 4
    assert (states[is_out] == UNSEEN).all()
    assert (states[is_in] == KEPT).all()
    errors = np.linalg.norm(result.displacement - FIELD.displacement(MESH.nodes), axis=1)
    inner: NDArray[np.bool_] = moved[:, 0] < columns - 20
    assert errors[inner].max() <= 0.12
    assert np.isnan(errors[moved[:, 0] > columns + 20]).all() != regularized


def test_a_start_that_is_far_off_excludes_nothing_at_once() -> None:
    # From rest, 2.8 px off: everything stands out, and nothing is spoilt.
    options = {"start": dict.fromkeys(("rigid", "features", "pyramid", "independent"), False)}
    result = ddic.measure(clean().pair, MESH, **options)
    assert (result.fields["excluded"] == KEPT).all()
    assert np.linalg.norm(result.displacement - FIELD.displacement(MESH.nodes), axis=1).max() <= 0.1



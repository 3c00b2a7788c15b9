"""What a residual says about a cell: the error that would leave it, whatever noise and brightness."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.functionals.grey_statistics import GreyCorrection
from ddic.parallel.distribution import split_evenly
from ddic.parallel.team import Team
from ddic.synth.fields import Translation
from ddic.visibility.cell_errors import (
    CellErrors,
    CellResiduals,
    describe_doubtful_cells,
    find_cell_errors,
    measure_cell_residuals,
)
from support.fields import field_of
from support.one_subdomain import model_of
from support.pictures import pair_of, source, square_mesh

MESH = square_mesh(24.0, 168.0)
FIELD = Translation((0.3, -0.4))
PAIR = pair_of(FIELD)
CENTRES = MESH.nodes[MESH.connectivity.reshape(-1, 4)].mean(axis=1)
NOISE = 2.0
RNG = np.random.default_rng(2)


def judge(deformed: NDArray[np.float64], q: NDArray[np.float64], correction: GreyCorrection = "none",
          noise: float = NOISE) -> CellErrors:
    f, g = (image + noise * RNG.normal(size=image.shape) for image in (PAIR.reference, deformed))
    model = model_of(source(f), source(g), MESH, correction)
    view = model.views[0][0]
    residual = model.evaluate(field_of(model, [q])).residuals[0][0]
    return find_cell_errors(Team.alone(), [measure_cell_residuals(view, view.assemble_hessian(), residual)])[0]


def displacement(error: NDArray[np.float64]) -> NDArray[np.float64]:
    """The truth, and errors (n_nodes, 2) of some nodes."""
    return np.asarray((np.array(FIELD.vector) + error).ravel())


@pytest.mark.parametrize("error", [0.25, 0.5])
def test_a_wrong_cell_has_about_its_error(error: float) -> None:
    far_off = np.linalg.norm(MESH.nodes - 96.0, axis=1) < 30.0
    angle = RNG.uniform(0, 2 * np.pi)
    errors = np.outer(far_off, error * np.array([np.cos(angle), np.sin(angle)]))
    found = judge(PAIR.deformed, displacement(errors))
    wrong = far_off[MESH.connectivity.reshape(-1, 4)].all(axis=1)
    right = ~far_off[MESH.connectivity.reshape(-1, 4)].any(axis=1)
    # Cells of 256 px see the texture along one direction better than along the other.
    assert np.median(found.equivalent[wrong]) == pytest.approx(error, rel=0.25)
    assert found.doubtful[wrong].all()
    assert not found.doubtful[right].any()


@pytest.mark.parametrize("noise", [0.0, 2.0, 8.0])
def test_noise_alone_marks_nothing(noise: float) -> None:
    found = judge(PAIR.deformed, displacement(np.zeros(MESH.nodes.shape)), noise=noise)
    assert not found.doubtful.any()


def test_brightness_alone_marks_nothing() -> None:
    found = judge(0.9 * PAIR.deformed + 12.0, displacement(np.zeros(MESH.nodes.shape)))
    assert not found.doubtful.any()


def test_what_is_covered_is_marked() -> None:
    covered = PAIR.deformed.copy()
    covered[80:120, 80:120] = 30.0
    found = judge(covered, displacement(np.zeros(MESH.nodes.shape)))
    inside = (np.abs(CENTRES - 100.0) < 10.0).all(axis=1)
    outside = (np.abs(CENTRES - 100.0) > 36.0).any(axis=1)
    assert inside.sum() >= 1
    assert found.doubtful[inside].all()
    assert not found.doubtful[outside].any()


def test_cells_without_pixels_are_marked() -> None:
    found = judge(PAIR.deformed, displacement(np.where(MESH.nodes[:, :1] > 150, 500.0, 0.0) * [1.0, 0.0]))
    gone = CENTRES[:, 0] > 152
    assert np.isnan(found.equivalent[gone]).all()
    assert found.doubtful[gone].all()


@pytest.mark.parallel([1, 3])
def test_each_camera_has_its_noise_whoever_owns_its_cells() -> None:
    team = Team(MPI.COMM_WORLD)
    n = np.full(40, 256.0)
    everything = [CellResiduals(2, k % 2, n, np.full(40, [4.0, 100.0][k % 2]) + np.where(np.arange(40) < k, 50.0, 0.0),
                                np.full(40, 200.0)) for k in range(6)]
    own = split_evenly(np.ones(6), team.size)[team.rank]
    found = find_cell_errors(team, [everything[k] for k in own])
    for k, errors in zip(own, found, strict=True):
        # 50 above the noise of either camera: sqrt(2 * 50 / 200).
        np.testing.assert_allclose(errors.equivalent, np.where(np.arange(40) < k, np.sqrt(0.5), 0.0), rtol=1e-12)
        np.testing.assert_array_equal(errors.doubtful, np.arange(40) < k)
    (line,), n_doubtful = describe_doubtful_cells(team, found)
    assert line.startswith("15 of 240 cells are marked doubtful")
    assert n_doubtful == 15

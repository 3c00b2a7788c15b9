"""A displacement to start from, from Python."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

import ddic
from ddic.errors import is_collective
from support.small_pair import REGULARIZED, SIZE, WITHIN, largest_error, move

Pair = tuple[NDArray[np.uint8], NDArray[np.uint8]]
ALONE = {"start": {"rigid": False, "features": False, "pyramid": False, "independent": False}}
JUMP = np.array([14.0, 9.0])


@pytest.fixture(scope="module")
def jumped() -> Pair:
    """The pair after a jump that Gauss-Newton alone does not follow."""
    return ddic.make_synthetic_pair(lambda points: move(points) + JUMP, SIZE, noise=1, seed=1)


def _points() -> NDArray[np.float64]:
    return np.random.default_rng(0).uniform((25, 25), (135, 115), (30, 2))


def test_a_result_is_gone_on_from(pair: Pair, jumped: Pair, mesh: ddic.Mesh) -> None:
    with ddic.prepare(pair[0], mesh, **REGULARIZED) as session:
        first = session.measure(pair[1])
        later = session.measure(jumped[1], start=first)
    assert np.abs(later.displacement - move(mesh.nodes) - JUMP).max() < 2 * WITHIN
    again = ddic.measure(pair, mesh, start=first, **REGULARIZED)
    assert len(again.gauss_newton["iteration"]) == 1
    assert np.abs(again.displacement - first.displacement).max() < 1e-3


def test_arrays_are_started_from(jumped: Pair, mesh: ddic.Mesh) -> None:
    points = _points()
    # As they are: no stage of the start is on, and Gauss-Newton alone fails from rest.
    with pytest.raises(ddic.ConvergenceError):
        ddic.measure(jumped, mesh, **ALONE)
    result = ddic.measure(jumped, mesh, start={"from_points": (points, move(points) + JUMP)} | ALONE["start"])
    assert np.abs(result.displacement - move(mesh.nodes) - JUMP).max() < 2 * WITHIN
    lists = [points.tolist(), (move(points) + JUMP).tolist()]
    listed = ddic.measure(jumped, mesh, start={"from_points": lists} | ALONE["start"])
    assert np.array_equal(listed.displacement, result.displacement)


def test_it_stands_for_what_a_case_says(case_file: Path) -> None:
    first = ddic.measure(case_file)
    again = ddic.measure(case_file, start=first)
    # Gauss-Newton stops at corrections of 1e-4 px or 1e-3 of the field.
    assert np.abs(again.displacement - first.displacement).max() < 2e-3
    with pytest.raises(ddic.InputError, match="none of 1 points lies in the mesh"):
        ddic.measure(case_file, start=([[5.0, 5.0]], [[0.0, 0.0]]))


@pytest.mark.parametrize(("start", "words"), [
    ("a.vtkhdf", "a.vtkhdf: no such result file"),
    ({"from_result": 3}, "start: int given; give a result, or a pair (points, displacement)"),
    (np.zeros((3, 2)), "start: ndarray given; give a result"),
    ((np.zeros((3, 2)),), "start: tuple given"),
    ((np.zeros((3, 3)), np.zeros((3, 3))), "start: points: an array of shape (3, 3), (n, 2) expected"),
    ((np.zeros((0, 2)), np.zeros((0, 2))), "start: points: an array of shape (0, 2), (n, 2) expected"),
    ((np.ones((3, 2)), np.ones((2, 2))), "start: 3 points and 2 displacements"),
    (([["a", "b"]], [[1, 2]]), "start: points: could not convert string to float"),
    ((np.full((1, 2), 50.0), np.array([[1.0, np.nan]])), "start[0]: holds a value that is not finite"),
    ((np.array([[50.0, 50.0], [500.0, 5.0]]), np.ones((2, 2))), "start[1]: (500, 5) lies outside the reference image"),
    ((np.full((1, 2), 50.0), np.array([[1e308, 1.0]])), "start[0]: moves by 1e+308 px, out of the image of"),
    ((np.array([[5.0, 5.0]]), np.ones((1, 2))), "start: none of 1 points lies in the mesh"),
])
def test_wrong_starts(pair: Pair, mesh: ddic.Mesh, start: Any, words: str) -> None:
    with pytest.raises(ddic.InputError) as caught:
        ddic.measure(pair, mesh, start=start)
    assert str(caught.value).startswith(words)


def test_one_start_is_enough(pair: Pair, mesh: ddic.Mesh) -> None:
    with ddic.prepare(pair[0], mesh) as session:
        first = session.measure(pair[1])
        with pytest.raises(ddic.InputError, match="from_last and start: give one of them"):
            session.measure(pair[1], from_last=True, start=first)


def _refused(call: Callable[[], object]) -> str:
    with pytest.raises(ddic.InputError) as caught:
        call()
    assert is_collective(caught.value)
    return str(caught.value)


@pytest.mark.parallel([3])
def test_all_ranks_start_alike(pair: Pair, jumped: Pair, mesh: ddic.Mesh) -> None:
    options = REGULARIZED | {"solver": {"subdomains": 4}}
    first = ddic.measure(pair, mesh, **options)
    later = ddic.measure((pair[0], jumped[1]), mesh, start=first, **options)
    alone = ddic.measure((pair[0], jumped[1]), mesh, start=first, comm=MPI.COMM_SELF, **options)
    assert np.abs(later.displacement - alone.displacement).max() < 1e-5
    assert np.abs(later.displacement - move(mesh.nodes) - JUMP).max() < 2 * WITHIN
    points = _points()
    result = ddic.measure(jumped, mesh, start=(points, move(points) + JUMP), **options)
    assert np.abs(result.displacement - move(mesh.nodes) - JUMP).max() < 2 * WITHIN
    assert largest_error(first) < WITHIN
    some = first if MPI.COMM_WORLD.rank == 0 else None
    assert _refused(lambda: ddic.measure(pair, mesh, start=some)).startswith("start: given on some of the ranks")
    wrong = first if MPI.COMM_WORLD.rank == 0 else 5
    assert _refused(lambda: ddic.measure(pair, mesh, start=wrong)).startswith("start: int given")  # type: ignore[arg-type]

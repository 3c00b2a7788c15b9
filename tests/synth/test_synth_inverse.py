from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ddic.errors import ConvergenceError, InputError
from ddic.synth.fields import Affine, Bending, Kirsch, Sinusoidal, Sum, Translation
from ddic.synth.render import find_reference_points

POINTS = np.random.default_rng(0).uniform(0, 900, (500, 2))
small = st.floats(-0.2, 0.2)


@dataclass(frozen=True)
class Torn:
    """Both sides of x = 50 move apart: nothing lands in the gap."""

    def displacement(self, points):
        return np.column_stack([np.where(points[:, 0] < 50, -1.0, 1.0), np.zeros(len(points))])

    def gradient(self, points):
        return np.zeros((len(points), 2, 2))


@pytest.mark.parametrize("field", [Sinusoidal(), Kirsch((60.0, 40.0), 20.0, 0.1), Bending(1e-3, (50.0, 50.0)),
                                   Sum((Sinusoidal(), Translation((-7.3, 2.2))))],
                         ids=lambda field: type(field).__name__)
def test_reference_points_land_on_the_given_points(field):
    y = np.random.default_rng(0).uniform(0, 100, (2000, 2))
    x = find_reference_points(field, y)
    # 1e-12 px asked of the displacement, and the rounding of coordinates of 100 px.
    np.testing.assert_allclose(x + field.displacement(x), y, rtol=0, atol=1.1e-12)


@given(a=small, b=small, c=small, d=small)
@settings(max_examples=25, deadline=None)
def test_affine_motions_are_inverted_as_by_linear_algebra(a, b, c, d):
    field = Affine(((a, b), (c, d)), (0.5, -0.5), (10.0, 20.0))
    y = np.random.default_rng(1).uniform(0, 100, (50, 2))
    motion = np.eye(2) + np.array(field.matrix)
    expected = np.array(field.center) + (y - field.center - field.vector) @ np.linalg.inv(motion).T
    # The residual of 1e-12 px times the inverse's norm, at most 1 / (1 - 0.4).
    np.testing.assert_allclose(find_reference_points(field, y), expected, rtol=0, atol=3e-12)


@given(entries=st.tuples(*9 * [small]))
@settings(max_examples=25, deadline=None)
def test_affine_motions_in_space_are_inverted_as_by_linear_algebra(entries):
    matrix = np.reshape(entries, (3, 3))
    field = Affine(tuple(map(tuple, matrix)), (0.5, -0.5, 1.5), (10.0, 20.0, 30.0))
    y = np.random.default_rng(1).uniform(0, 100, (50, 3))
    motion = np.eye(3) + matrix
    assume(np.linalg.det(motion) > 0.1)
    expected = np.array(field.center) + (y - field.center - field.vector) @ np.linalg.inv(motion).T
    # The residual of 1e-12 px, or four roundings of displacements below 100 px, times the inverse's norm: at most
    # 1.6^2 of two singular values over the determinant.
    np.testing.assert_allclose(find_reference_points(field, y), expected, rtol=0, atol=3e-11)


def test_far_from_the_origin_rounding_of_the_displacement_is_accepted():
    field = Affine(((0.3, 0.0), (0.0, 0.3)))
    y = np.array([[30_000.3, 29_999.7]])
    np.testing.assert_allclose(find_reference_points(field, y), y / 1.3, rtol=1e-15)


def test_a_fold_is_refused():
    with pytest.raises(InputError, match="folds the image"):
        find_reference_points(Sinusoidal(amplitude=(400.0, 0.0)), POINTS)


def test_a_fold_in_space_is_refused():
    field = Affine(((-1.5, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3), (0.0,) * 3, (0.0,) * 3)
    with pytest.raises(InputError, match=r"folds the image near \(.*, .*, .*\) px"):
        find_reference_points(field, np.ones((2, 3)))


def test_a_gap_does_not_pass_for_a_solution():
    with pytest.raises(ConvergenceError, match=r"at \(50, 3\) px"):
        find_reference_points(Torn(), np.array([[10.0, 3.0], [50.0, 3.0]]))


def test_no_points():
    assert find_reference_points(Sinusoidal(), np.zeros((0, 2))).shape == (0, 2)

"""Coarse fields as products."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.images.rigid import GridField, build_uniform_field
from ddic.problem.separated_problem import Rectangle
from ddic.start.multilevel import MultilevelStart
from ddic.start.separated_start import LOSS_PX, factorize_coarse_field
from support.separated import lines

# The grid begins and ends inside the rectangle on one side each: there it is constant beyond its edge.
REGION = (10.0, 20.0, 110.0, 90.0)
POINTS = np.random.default_rng(0).uniform((10, 20), (110, 90), (400, 2))


def _factorize(field: GridField, size: float) -> tuple[Rectangle, object]:
    rectangle = Rectangle(*lines(REGION, size))
    start = MultilevelStart(field, (), (8, 4), ())
    assert start.describe() == ("start: pyramid on blocks of 8, 4 px",)
    return rectangle, factorize_coarse_field(start, rectangle)


def test_products_are_the_coarse_field_at_the_nodes() -> None:
    random = np.random.default_rng(1)
    # Of rank 2: what is left out is nothing but rounding.
    values = np.stack([np.outer(random.normal(size=5), random.normal(size=6)) for _ in range(2)], axis=-1)
    values += np.array([3.0, -2.0])
    grid = GridField((15.5, 12.0), (16.0, 18.0), values)
    rectangle, found = _factorize(grid, 5.0)
    x, y = np.meshgrid(rectangle.along_x.nodes, rectangle.along_y.nodes)
    at = np.column_stack([x.ravel(), y.ravel()])
    assert found.n_modes == 2
    assert np.allclose(found.at(at), grid.at(at), rtol=0, atol=1e-12)


def test_small_modes_are_left_out() -> None:
    random = np.random.default_rng(2)
    values = np.ones((5, 6, 2)) + 1e-3 * random.normal(size=(5, 6, 2))
    _, found = _factorize(GridField((10.0, 20.0), (20.0, 17.5), values), 5.0)
    assert found.n_modes == 1
    assert np.abs(found.at(POINTS) - 1.0).max() <= 5 * LOSS_PX


@pytest.mark.parametrize("size", [1.0, 35.0])
def test_translation_is_one_product(size: float) -> None:
    _, found = _factorize(build_uniform_field((3.25, -7.5)), size)
    assert found.n_modes == 1
    assert np.allclose(found.at(POINTS), (3.25, -7.5), rtol=0, atol=1e-12)

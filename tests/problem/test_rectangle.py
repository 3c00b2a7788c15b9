"""The rectangle of a case and the cells on which its displacement is written out."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.case.schema import Case
from ddic.mesh.structured import build_structured_mesh
from ddic.problem.separated_problem import (
    MOST_CELLS,
    OUTPUT_PX,
    build_rectangle,
    choose_controlled_lines,
    choose_output_lines,
    find_rectangle,
)


def _case(region: tuple[float, float, float, float], size: float, **more: object) -> Case:
    return Case.model_validate({"images": {"reference": "f.tif", "deformed": "g.tif"}, "pgd": more.pop("pgd", {}),
                                "mesh": {"structured": {"region": region, "element_size": size}}, **more})


@pytest.mark.parametrize("size", [1.0, 7.0])
def test_lines_are_those_of_the_structured_mesh(size: float) -> None:
    region = (3.0, 5.0, 53.0, 33.0)
    found, given = find_rectangle(build_structured_mesh(region, size)), build_rectangle(_case(region, size))
    assert np.allclose(found.along_x.nodes, given.along_x.nodes, rtol=0, atol=1e-9)
    assert np.allclose(found.along_y.nodes, given.along_y.nodes, rtol=0, atol=1e-9)
    assert given.bounds == region


@pytest.mark.parametrize(("side", "size", "spacing"), [(100, 1.0, None), (100, 16.0, None), (3000, 1.0, None),
                                                       (101, 1.0, 10.0), (97, 1.0, 10.0), (64, 16.0, 40.0)])
def test_cells_are_of_whole_elements_and_fill_the_rectangle(side: float, size: float, spacing: float | None) -> None:
    case = _case((10.0, 10.0, 10.0 + side, 10.0 + side), size, pgd={"output_spacing": spacing})
    rectangle = build_rectangle(case)
    x, _ = choose_output_lines(case, rectangle)
    assert np.isin(x, rectangle.along_x.nodes).all()
    assert (x[0], x[-1]) == (10.0, 10.0 + side)
    widths = np.diff(x)
    wanted = max(OUTPUT_PX, size) if spacing is None else spacing
    # The last one takes what is left over.
    assert widths.min() >= (0.5 if spacing is None else 0.45) * wanted
    assert len(widths)**2 <= MOST_CELLS
    if spacing is not None:
        assert widths.max() <= 1.5 * max(spacing, size)


@pytest.mark.parametrize(("names", "n_x", "n_y"), [(("boundary",), 5, 3), ((), 7, 5), (("left",), 6, 5),
                                                   (("left", "top", "bottom"), 6, 3)])
def test_sides_are_not_controlled_by_name(names: tuple[str, ...], n_x: int, n_y: int) -> None:
    case = _case((0.0, 0.0, 60.0, 40.0), 10.0, regularization={"eta": 1.0, "not_controlled": names})
    lines = choose_controlled_lines(case.regularization, build_rectangle(case))
    assert (lines.x.sum(), lines.y.sum()) == (n_x, n_y)
    assert lines.x[0] == (("left" not in names) and ("boundary" not in names))

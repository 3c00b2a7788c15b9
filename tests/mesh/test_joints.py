"""Meshes whose cells do not meet side to side."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.errors import InputError
from ddic.mesh.cell_type import Q4, T3
from ddic.mesh.joints import check_joints
from ddic.mesh.mesh import Mesh, build_mesh

SQUARE = [(10, 10), (30, 10), (50, 10), (10, 30), (30, 30), (50, 30)]
TWO = [(0, 1, 4, 3), (1, 2, 5, 4)]


def _build(nodes: list[tuple[float, float]], quads: list[tuple[int, ...]], triangles: tuple[tuple[int, ...], ...] = (),
           ) -> Mesh:
    blocks = [(Q4, np.array(quads, np.int64).reshape(-1, 4)), (T3, np.array(triangles, np.int64).reshape(-1, 3))]
    return build_mesh(np.array(nodes, np.float64), blocks)


def test_cells_side_to_side_and_a_slit_between_nodes_at_one_place_are_sound() -> None:
    check_joints(_build(SQUARE, TWO))
    check_joints(_build([*SQUARE, (30, 10), (30, 30)], [TWO[0], (6, 2, 5, 7)]))


BAD = {
    "a side of three cells": (_build([*SQUARE, (40, 24)], TWO, ((1, 6, 4),)), "belong to more than two cells"),
    "a node on a side": (_build([(10, 10), (30, 10), (10, 30), (30, 30), (50, 10), (50, 20), (30, 20)],
                                [(0, 1, 3, 2), (1, 4, 5, 6)]), r"1 nodes lie on a side .* \(30, 20\)"),
    "a cell over others": (_build([*SQUARE, (15, 12), (45, 12), (30, 28)], TWO, ((6, 7, 8),)),
                           r"3 cells .*0, 1, 2\) lie over others"),
}


@pytest.mark.parametrize(("mesh", "reason"), BAD.values(), ids=BAD)
def test_others_are_refused(mesh: Mesh, reason: str) -> None:
    with pytest.raises(InputError, match=reason) as caught:
        check_joints(mesh)
    # Three cells at a side lie over one another as well, which is no other fault.
    assert len(caught.value.problems) == 1

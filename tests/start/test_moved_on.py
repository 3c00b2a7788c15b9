"""A given displacement, moved on by translations."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.mesh.cell_type import Q4
from ddic.mesh.mesh import build_mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.start.binned_pair import BinnedPair
from ddic.start.coarse_displacement import CutField
from ddic.start.rigid_start import move_on
from ddic.synth.fields import Affine, DisplacementField
from support.pictures import pair_of, source, square_mesh

SIDE = 384
MESH = square_mesh(120.0, 264.0)
CENTRE = (191.5, 191.5)


def _turned(degrees: float, shift: tuple[float, float]) -> Affine:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return Affine(((c - 1, -s), (s, c - 1)), shift, CENTRE)


def _pair(field: DisplacementField) -> BinnedPair:
    pair = pair_of(field, SIDE, 8)
    return BinnedPair(source(pair.reference), source(pair.deformed), 1)


@pytest.mark.parametrize("degrees", [0.0, 35.0, 170.0])
def test_the_jump_is_found_whatever_the_rotation(degrees: float) -> None:
    earlier, later = _turned(degrees, (3.0, 2.0)), _turned(degrees, (-27.0, 42.0))
    (found,) = move_on(CutField(MESH, earlier.displacement(MESH.nodes)), _pair(later))
    # The vertex of a parabola; the reference image is interpolated linearly where it is turned.
    np.testing.assert_allclose(found.translations[0].shift, (-30.0, 40.0), atol=0.15)
    np.testing.assert_allclose(found.field.displacement, later.displacement(MESH.nodes), atol=0.15)
    assert found.translations[0].coefficient > 0.85


def test_pieces_are_moved_on_by_themselves() -> None:
    upper = build_structured_mesh((120.0, 100.0, 264.0, 180.0), 16)
    cells = upper.cells[:, :4]
    nodes = np.vstack([upper.nodes, upper.nodes + np.array([0.0, 100.0])])
    mesh = build_mesh(nodes, {Q4: np.vstack([cells, cells + upper.n_nodes])})
    pair = _pair(_turned(0.0, (12.0, -5.0)))
    # The lower piece is given 20 px beside the truth, the upper one 30 px to the other side.
    off = np.repeat([[-30.0, 0.0], [20.0, 0.0]], upper.n_nodes, axis=0)
    pieces, *_ = move_on(CutField(mesh, np.array([12.0, -5.0]) + off), pair)
    np.testing.assert_allclose(pieces.field.displacement, np.tile((12.0, -5.0), (mesh.n_nodes, 1)), atol=0.15)


def test_nothing_stands_out_of_unrelated_images_or_of_a_torn_field() -> None:
    related, other = _pair(_turned(0.0, (0.0, 0.0))), np.random.default_rng(0).uniform(0, 255, (SIDE, SIDE))
    unrelated = BinnedPair(related.reference, source(other.astype(np.float32)), 1)
    assert move_on(CutField(MESH, np.zeros_like(MESH.nodes)), unrelated) == []
    torn = np.random.default_rng(1).uniform(-500, 500, MESH.nodes.shape)
    assert move_on(CutField(MESH, torn), related) == []

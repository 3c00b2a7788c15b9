"""Speckles matched by their looks: any rotation, pieces that part, and nothing where there is nothing."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.mesh.cell_type import Q4
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.start.binned_pair import BinnedPair
from ddic.start.feature_matches import MatchedField, find_pieces, match_features
from ddic.synth.speckle import SpeckleTexture
from support.pictures import source

Array = NDArray[np.float64]
SIDE = 420
MIDDLE = np.array([SIDE / 2, SIDE / 2])
MESH = build_structured_mesh((120, 120, 300, 300), 15)


def _picture(origins: Array, seed: int = 3) -> NDArray[np.uint8]:
    grey = 255 * SpeckleTexture(seed).grey(*origins.T).reshape(SIDE, SIDE)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def _pixels() -> Array:
    y, x = np.mgrid[0:SIDE, 0:SIDE].astype(float)
    return np.column_stack([x.ravel(), y.ravel()])


def _pair(origins: Array, seed: int = 3) -> BinnedPair:
    return BinnedPair(source(_picture(_pixels())), source(_picture(origins, seed)), 1)


def _find(pair: BinnedPair, mesh: Mesh) -> MatchedField:
    pieces = find_pieces(mesh)
    matches = match_features(pair, mesh, pieces)
    assert matches.agree
    return MatchedField(matches, mesh, pieces)


@pytest.mark.parametrize("degrees", [3.0, 37.0, 90.0, 180.0, 263.0])
@pytest.mark.parametrize("scale", [0.85, 1.2])
def test_any_rotation_is_found(degrees: float, scale: float) -> None:
    angle = np.deg2rad(degrees)
    motion = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shift = np.array([12.3, -7.6])
    field = _find(_pair(MIDDLE + (_pixels() - MIDDLE - shift) @ np.linalg.inv(motion).T), MESH)
    wanted = MIDDLE + (MESH.nodes - MIDDLE) @ motion.T + shift - MESH.nodes
    error = np.linalg.norm(field.interpolate_at_nodes(MESH) - wanted, axis=1)
    # Features are located to some hundredths of a pixel, fewer at the edge of the region.
    assert np.median(error) < 0.1
    assert error.max() < 1.0


def test_pieces_that_part_keep_their_own_displacement() -> None:
    upper, lower = build_structured_mesh((120, 100, 300, 205), 15), build_structured_mesh((120, 215, 300, 320), 15)
    mesh = build_mesh(np.vstack([upper.nodes, lower.nodes]),
                      {Q4: np.vstack([upper.cells[:, :4], lower.cells[:, :4] + upper.n_nodes])})
    apart = 24.0
    pixels = _pixels()
    origins = np.where((pixels[:, 1] > 210 + apart / 2)[:, None], pixels - [0.0, apart], pixels)
    found = _find(_pair(origins), mesh).interpolate_at_nodes(mesh)
    is_lower = np.arange(mesh.n_nodes) >= upper.n_nodes
    np.testing.assert_allclose(found[~is_lower], 0.0, atol=0.1)
    np.testing.assert_allclose(found[is_lower], np.tile([0.0, apart], (is_lower.sum(), 1)), atol=0.1)


def test_unrelated_images_have_nothing_in_common() -> None:
    matches = match_features(_pair(_pixels(), seed=9), MESH, find_pieces(MESH))
    assert not matches.agree


def test_blank_images_have_no_features() -> None:
    flat = source(np.full((SIDE, SIDE), 128, np.uint8))
    matches = match_features(BinnedPair(flat, flat, 1), MESH, find_pieces(MESH))
    assert not matches.agree
    assert matches.n_found == 0

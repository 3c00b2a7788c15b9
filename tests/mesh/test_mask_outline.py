"""Meshes that conform to a mask image."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.mesh.holes import find_mask_holes
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_areas, measure_shape_quality
from ddic.mesh.structured import build_structured_mesh

REGION = (10.0, 10.0, 190.0, 170.0)
SIZE = 10.0
X, Y = np.meshgrid(np.arange(200), np.arange(180))


def mesh_of(mask: NDArray[np.bool_]) -> Mesh:
    return build_structured_mesh(REGION, SIZE, polygons=find_mask_holes(mask, REGION, SIZE))


def test_a_round_mask_gives_the_mesh_of_a_circle() -> None:
    mask = (X - 100.3) ** 2 + (Y - 90.6) ** 2 > 40.0**2
    mesh = mesh_of(mask)
    away = np.hypot(*(mesh.nodes[mesh.node_sets["hole_0"]] - [100.3, 90.6]).T)
    # Edges of pixels are half a pixel off at most, and the outline another 0.8 px; a staircase of cells, 5 px.
    np.testing.assert_allclose(away, 40.0, rtol=0, atol=1.4)
    circle = build_structured_mesh(REGION, SIZE, circles=[((100.3, 90.6), 40.0)])
    assert mesh.n_cells == circle.n_cells
    assert len(mesh.node_sets["hole_0"]) == len(circle.node_sets["hole_0"])
    assert measure_areas(mesh).sum() == pytest.approx(mask[10:170, 10:190].sum(), rel=0.005)


def test_corners_have_nodes_and_slanted_sides_are_straight() -> None:
    # A rectangle turned by 20 degrees.
    c, s = np.cos(np.deg2rad(20)), np.sin(np.deg2rad(20))
    along, across = c * (X - 100) + s * (Y - 90), -s * (X - 100) + c * (Y - 90)
    mesh = mesh_of(~((np.abs(along) < 45) & (np.abs(across) < 30)))
    nodes = mesh.nodes[mesh.node_sets["hole_0"]] - [100, 90]
    turned = np.abs(nodes @ np.array([[c, -s], [s, c]]))
    off = np.minimum(np.abs(turned[:, 0] - 45), np.abs(turned[:, 1] - 30))
    # Half a pixel and what counts as straight.
    assert off.max() < 1.5
    at_corner = np.linalg.norm(turned - [45, 30], axis=1)
    # Four of them, within the pixels that a mask rounds a corner by.
    assert (at_corner < 2.0).sum() >= 4
    # Snapping keeps 12 degrees in the worst of cases.
    assert measure_shape_quality(mesh).min() > 0.2


@pytest.mark.parametrize("outline", ["staircase", "snapped"])
def test_an_outer_outline_is_the_sides_and_an_inner_one_a_hole(outline: str) -> None:
    # A ring-shaped specimen on a dark ground that fills the image.
    away = np.hypot(X - 100, Y - 90)
    mask = (away < 70) & (away > 25)
    mesh = mesh_of(mask) if outline == "snapped" else build_structured_mesh(REGION, SIZE, mask=mask)
    assert set(mesh.node_sets) == {"left", "right", "top", "bottom", "hole_0"}
    # Half a pixel and what counts as straight; half the diagonal of an element.
    slack = 1.4 if outline == "snapped" else SIZE / np.sqrt(2)
    for name, nodes in mesh.node_sets.items():
        across = mesh.nodes[nodes] - [100, 90]
        np.testing.assert_allclose(np.hypot(*across.T), 25 if name == "hole_0" else 70, rtol=0, atol=slack)
    x, y = (mesh.nodes - [100, 90]).T
    for name, ahead in {"left": -x, "right": x, "top": -y, "bottom": y}.items():
        # In its quadrant, but for half an edge; the steps of a staircase face left all along its left half.
        assert (ahead[mesh.node_sets[name]] > (70 / np.sqrt(2) - SIZE if outline == "snapped" else 0)).all()


def test_holes_of_a_mask_are_numbered_on_from_top_to_bottom() -> None:
    mask = np.ones((180, 200), dtype=bool)
    for x, y in ((140, 50), (60, 130), (70, 80)):
        mask[y - 15:y + 15, x - 15:x + 15] = False
    # At the edge, hence no hole.
    mask[:40, :40] = False
    mesh = build_structured_mesh(REGION, SIZE, circles=[((150.0, 140.0), 12.0)], mask=mask)
    assert list(mesh.node_sets) == ["left", "right", "top", "bottom", "hole_0", "hole_1", "hole_2", "hole_3"]
    middles = [mesh.nodes[mesh.node_sets[f"hole_{k}"]].mean(axis=0) for k in range(4)]
    np.testing.assert_allclose(middles, [(150, 140), (140, 50), (70, 80), (60, 130)], atol=SIZE / 2)
    # The corner that is left out faces left and up.
    assert mesh.nodes[mesh.node_sets["left"], 0].max() == 40
    assert mesh.nodes[mesh.node_sets["top"], 1].max() == 40


def test_specks_and_pixels_outside_the_image() -> None:
    mask = np.ones((180, 200), dtype=bool)
    mask[60:63, 60:63] = False
    assert mesh_of(mask).n_cells == 18 * 16
    wide = (-20.0, -20.0, 100.0, 100.0)
    mesh = build_structured_mesh(wide, SIZE, polygons=find_mask_holes(mask, wide, SIZE))
    # The image's first pixel begins at -0.5.
    assert mesh.nodes.min(axis=0).tolist() == [-0.5, -0.5]

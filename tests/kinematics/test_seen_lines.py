"""Lines and cut cells in a camera's pixels."""

from __future__ import annotations

import numpy as np

from ddic.images.camera import CameraMapping, similarity
from ddic.kinematics.camera import CameraSetup, see_discontinuities, see_mesh
from ddic.kinematics.enriched import Discontinuities
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.plane import measure_distance
from ddic.mesh.raster import rasterize
from ddic.mesh.structured import build_structured_mesh

MESH = build_structured_mesh((100, 60, 160, 120), 12)
LINE = np.array([[-4000.0, -1572.0], [4000.0, 1648.3]])
# Beyond x = -500 px of the specimen it has no image.
TILTED = CameraMapping(np.array([[4.1, 0.12, -350.0], [-0.1, 3.95, -185.0], [2e-3, -1.5e-4, 1.0]]))


def test_a_line_is_seen_along_the_mesh_alone() -> None:
    seen = see_discontinuities(Discontinuities((LINE,), ("normal",)), MESH, TILTED)
    (line,) = seen.lines
    assert seen.openings == ("normal",)
    # A perspective keeps lines straight.
    direction = line[-1] - line[0]
    across = np.array([-direction[1], direction[0]]) / np.linalg.norm(direction)
    assert np.abs((line - line[0]) @ across).max() < 1e-9
    on_line = LINE[0] + np.linspace(0, 1, 20001)[:, None] * (LINE[1] - LINE[0])
    inside = on_line[((on_line > (88, 48)) & (on_line < (172, 132))).all(axis=1)]
    assert measure_distance(TILTED.to_image(inside), line).max() < 1e-9


def test_a_line_that_passes_elsewhere_is_not_seen() -> None:
    away = np.array([[0.0, 300.0], [400.0, 310.0]])
    assert see_discontinuities(Discontinuities((away,), ("both",)), MESH, TILTED).lines == ()


def test_parts_of_a_cut_cell_cover_its_pixels() -> None:
    for mapping in (similarity(4.0, 20.0, (-200.0, -250.0)), TILTED):
        setup = CameraSetup(mapping, "none", np.zeros(2), 1.0)
        cut = cut_mesh(MESH, [LINE])
        whole = rasterize(see_mesh(MESH, setup)).pixel_counts
        parts = rasterize(see_mesh(cut.mesh, setup)).pixel_counts
        np.testing.assert_array_equal(np.bincount(cut.cell_of, weights=parts), whole)
        assert len(parts) > len(whole)

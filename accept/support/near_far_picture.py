"""Four panels of strain: far and near field measured alone, continuous, regularized.

Those of Fig. 4 of [BP17] are meshes displaced 30 times: as measured, less alpha0, by Eq. 21, by Eq. 23.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accept.support.near_far_case import Fields
from ddic.kinematics.strain import compute_strain
from ddic.plots.cameras import CellPanel, draw_cell_panels
from ddic.plots.canvas import find_mesh_bounds, save_figure

AROUND = 0.35


def draw_panels(fields: Mapping[str, Fields], path: Path) -> None:
    """Strain along y around the near field; fields: independent, continuous, regularized."""
    alone, joint, regularized = (fields[name] for name in ("independent", "continuous", "regularized"))
    near = alone.mesh.create_submesh(np.flatnonzero(alone.cells == 1))[0]
    panels = [_panel("(a) far field alone", alone, [0]), _panel("(b) near field alone", alone, [1]),
              _panel("(c) continuous, Eq. 21", joint, [0, 1]), _panel("(d) regularized, Eq. 23", regularized, [0, 1])]
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(draw_cell_panels(panels, [near], find_mesh_bounds(near.nodes, AROUND), r"$\varepsilon_{yy}$ [-]"), path)


def _panel(title: str, fields: Fields, cameras: list[int]) -> CellPanel:
    shown = fields.mesh.create_submesh(np.flatnonzero(np.isin(fields.cells, cameras)))[0]
    values = np.concatenate([_strain(fields, camera) for camera in cameras])
    order = np.argsort(np.concatenate([np.flatnonzero(fields.cells == camera) for camera in cameras]))
    return CellPanel(title, shown, values[order])


def _strain(fields: Fields, camera: int) -> NDArray[np.float64]:
    part, _ = fields.mesh.create_submesh(np.flatnonzero(fields.cells == camera))
    return compute_strain(part, fields.u[camera].ravel()).infinitesimal[:, 1]

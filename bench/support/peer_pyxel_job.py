"""pyxel-dic on an image pair: CPU seconds from images on disk to the field in memory; runs in the peers' environment.

Usage: peer_pyxel_job.py TASK, with TASK a JSON object: folder and warm_up (image pairs), margin and element (px),
interpolation ("own" or "compiled"), field (the file that takes nodes and displacement, px).
"""

from __future__ import annotations

import json
import sys
import time
from importlib.metadata import version

import cv2
import numpy as np
import pyxel
from numpy.typing import NDArray
from peer_spline import replace_interpolation

Field = NDArray[np.float64]


def measured(folder: str, margin: int, element: int) -> tuple[Field, Field]:
    """Nodes (n, 2) and their displacement (n, 2), pixels, y down.

    The full rule, one point a pixel, at pyxel's defaults: no regularization, start from zero, tolerance 1e-3.
    """
    reference, deformed = (pyxel.Image(f"{folder}/{name}.tif").Load() for name in ("reference", "deformed"))
    height, width = reference.pix.shape
    # Half a pixel off: the borders of cells lie between pixels, and integration points are pixels.
    region = np.array([[margin, margin], [width - margin, height - margin]]) - 0.5
    mesh, camera = pyxel.MeshFromROI(region, element, typel=3)
    mesh.Connectivity()
    mesh.DICIntegrationFast(element)
    solution, _ = pyxel.Correlate(reference, deformed, mesh, camera, disp=False)
    # pyxel's y axis points up.
    return mesh.n * [1, -1], mesh.DOF2Nodes(solution) * [1, -1]


def main(argument: str) -> None:
    task = json.loads(argument)
    cv2.setNumThreads(1)
    if task["interpolation"] == "compiled":
        replace_interpolation()
    # A tiny pair first, as for ddic: compilation is in neither program's seconds.
    measured(task["warm_up"], task["margin"], task["element"])
    start = time.process_time()
    nodes, displacement = measured(task["folder"], task["margin"], task["element"])
    seconds = time.process_time() - start
    np.savez(task["field"], points=nodes, displacement=displacement)
    print(json.dumps({"cpu_seconds": seconds, "version": version("pyxel-dic"), "n_points": len(nodes),
                      "n_unusable": 0}))


main(sys.argv[1])

"""al-dvc on a pair of volumes: CPU seconds from files to the field in memory; runs in the peers' environment.

Usage: peer_aldvc_job.py TASK, with TASK a JSON object: folder and warm_up (pairs), subset and step (voxels), margin
(without centres, voxels), field (the file that takes points and displacement). Or make (the folder), size and stretch:
writes a pair.
"""

from __future__ import annotations

import json
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from al_dvc.core.config import dvcpara_default
from al_dvc.core.data_structures import STATUS_CONVERGED, VOIRange
from al_dvc.core.pipeline import run_aldvc
from al_dvc.synthetic import affine_displacement, generate_speckle_volume, warp_volume_lagrangian


def make(folder: Path, size: int, stretch: float) -> None:
    """Write a speckle and the same stretched along x about the middle."""
    reference = generate_speckle_volume((size,) * 3)
    middle = (0.5 * (size - 1),) * 3
    moved = warp_volume_lagrangian(reference, affine_displacement(np.diag([stretch, 0.0, 0.0]), centre=middle))
    np.save(folder / "reference.npy", reference)
    np.save(folder / "deformed.npy", moved)


def measured(folder: str, task: dict[str, Any]) -> Any:
    """al-dvc's result."""
    pair = [np.load(f"{folder}/{name}.npy") for name in ("reference", "deformed")]
    low, high = task["margin"], len(pair[0]) - 1 - task["margin"]
    settings = dvcpara_default(winsize=task["subset"], winstepsize=task["step"],
                               voi=VOIRange((low, high), (low, high), (low, high)))
    return run_aldvc(settings, pair, compute_strain=False)


def main(argument: str) -> None:
    task = json.loads(argument)
    if "make" in task:
        make(Path(task["make"]), task["size"], task["stretch"])
        print("{}")
        return
    measured(task["warm_up"], task)
    start = time.process_time()
    found = measured(task["folder"], task)
    seconds = time.process_time() - start
    frame, points = found.result_disp[0], found.dvc_mesh.coordinates
    usable = frame.status.ravel() == STATUS_CONVERGED
    np.savez(task["field"], points=points[usable], displacement=frame.U[usable])
    print(json.dumps({"cpu_seconds": seconds, "package": "al-dvc", "version": version("al-dvc"),
                      "n_points": len(points), "n_unusable": int((~usable).sum())}))


main(sys.argv[1])

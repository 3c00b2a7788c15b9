"""spam's ldic on a pair of volumes: CPU seconds from files to the field in memory; runs in the peers' environment.

Usage: peer_spam_job.py TASK, with TASK a JSON object: folder and warm_up (pairs), subset and step (voxels), margin
(without centres, voxels), field (the file that takes points and displacement).
"""

from __future__ import annotations

import json
import resource
import sys
from importlib.metadata import version
from typing import Any

import numpy as np
import spam.DIC
from numpy.typing import NDArray

CONVERGED = 2
"""What spam says of a subset that did."""


def measured(folder: str, task: dict[str, Any]) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Centres of the subsets and their displacement, (z, y, x), and what spam says of each."""
    pair = [np.load(f"{folder}/{name}.npy") for name in ("reference", "deformed")]
    centres, _ = spam.DIC.makeGrid(pair[0].shape, task["step"])
    inside = ((centres >= task["margin"]) & (centres < len(pair[0]) - task["margin"])).all(axis=1)
    centres = centres[inside]
    phi, status, *_ = spam.DIC.ldic(*pair, centres, [task["subset"] // 2] * 3, processes=1)
    return centres, phi[:, :3, 3], status


def spent() -> float:
    """CPU seconds of this process and of its workers, which have ended."""
    return sum(used.ru_utime + used.ru_stime
               for used in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)))


def main(argument: str) -> None:
    task = json.loads(argument)
    measured(task["warm_up"], task)
    start = spent()
    centres, displacement, status = measured(task["folder"], task)
    seconds = spent() - start
    usable = (status == CONVERGED) & np.isfinite(displacement).all(axis=1)
    np.savez(task["field"], points=centres[usable, ::-1].astype(float), displacement=displacement[usable, ::-1])
    print(json.dumps({"cpu_seconds": seconds, "package": "spam", "version": version("spam"), "n_points": len(centres),
                      "n_unusable": int((~usable).sum())}))


main(sys.argv[1])

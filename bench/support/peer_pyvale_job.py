"""pyvale on an image pair: CPU seconds from images on disk to the field in memory; runs in the peers' environment.

Usage: peer_pyvale_job.py TASK, with TASK a JSON object: folder and warm_up (image pairs), margin (px), settings
(keywords of pyvale.dic.calculate_2d), field (the file that takes points and displacement, px).
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pyvale import dic
from pyvale.dic.dicresults import Results


def region(folder: str, margin: int) -> NDArray[np.bool_]:
    """The pixels at least a margin from the image's border, (height, width)."""
    with Image.open(f"{folder}/reference.tif") as image:
        width, height = image.size
    mask = np.zeros((height, width), np.bool_)
    mask[margin:height - margin, margin:width - margin] = True
    return mask


def measured(folder: str, mask: NDArray[np.bool_], settings: dict[str, Any], output: Path) -> Results:
    """Points, displacement and convergence, pixels. pyvale passes its field through a file; binary is the quicker."""
    height, width = mask.shape
    dic.calculate_2d(reference=Path(folder, "reference.tif"), deformed=Path(folder, "deformed.tif"), roi_mask=mask,
                     seed=[width // 2, height // 2], num_threads=1, output_basepath=output, output_binary=True,
                     print_level=0, **settings)
    return dic.import_2d(data=output / "dic_results_deformed.dic2d", delimiter=",", binary=True, layout="column",
                         print_level=0)


def main(argument: str) -> None:
    task = json.loads(argument)
    mask = region(task["folder"], task["margin"])
    with tempfile.TemporaryDirectory() as output:
        measured(task["warm_up"], region(task["warm_up"], task["margin"]), task["settings"], Path(output))
        start = time.process_time()
        found = measured(task["folder"], mask, task["settings"], Path(output))
        seconds = time.process_time() - start
    points = np.column_stack([found.ss_x, found.ss_y]).astype(np.float64)
    displacement = np.column_stack([found.u_px[0], found.v_px[0]])
    usable = found.converged[0] & np.isfinite(displacement).all(axis=1)
    np.savez(task["field"], points=points[usable], displacement=displacement[usable])
    print(json.dumps({"cpu_seconds": seconds, "version": version("pyvale"), "n_points": len(points),
                      "n_unusable": int((~usable).sum())}))


main(sys.argv[1])

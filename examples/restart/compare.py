"""Compare both frames' fields with the ones that their images were made from."""

import json
import sys
from pathlib import Path

import numpy as np

from ddic.io.result_reader import read_result
from ddic.synth.truth import load_truth


def main(folder: Path) -> None:
    for frame in ("frame_1", "frame_2"):
        result = read_result(folder / f"{frame}.vtkhdf")
        summary = json.loads((folder / f"{frame}.json").read_text())
        error = result.displacement - load_truth(folder / frame / "truth.json").displacement(result.mesh.nodes)
        start = summary["notes"][0].removeprefix("start: ").split(" of ")[0]
        print(f"{frame}: RMS error {np.sqrt((error**2).mean()):.5f} px per component, "
              f"{summary['iterations']} iterations, started from {start}")


main(Path(sys.argv[1]))

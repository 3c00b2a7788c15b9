"""Compare the measured translation with the one that the images were made from."""

import sys
from pathlib import Path

import numpy as np

from ddic.io.result_reader import read_result
from ddic.synth.truth import load_truth


def main(folder: Path) -> None:
    result = read_result(folder / "result.vtkhdf")
    error = result.displacement - load_truth(folder / "images" / "truth.json").displacement(result.mesh.nodes)
    x, y = result.displacement.mean(axis=0)
    print(f"mean displacement: ({x:.4f}, {y:.4f}) px")
    print(f"RMS error against the known translation: {np.sqrt((error**2).mean()):.5f} px per component")


main(Path(sys.argv[1]))

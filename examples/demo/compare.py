"""Compare the demo's measured field with the one that its images were made from."""

import json
import sys
from pathlib import Path

import numpy as np

from ddic.api.studies import estimate_nodal_noise
from ddic.case.loader import load_case
from ddic.inputs.inputs import open_inputs
from ddic.io.result_reader import read_result
from ddic.parallel.team import Team
from ddic.synth.truth import load_truth


def main(folder: Path) -> None:
    truth_file = folder / "images" / "truth.json"
    result = read_result(folder / "result.vtkhdf")
    error = result.displacement - load_truth(truth_file).displacement(result.mesh.nodes)
    sigma = json.loads(truth_file.read_text())["image"]["noise"]
    # Rounding to whole grey levels is noise too, of variance 1/12.
    total = float(np.hypot(sigma, 12**-0.5))
    inputs, _ = open_inputs(Team.alone(), load_case(folder / "case.toml"))
    floor = estimate_nodal_noise(inputs, total)
    rms = float(np.sqrt((error**2).mean()))
    print(f"RMS error against the known field: {rms:.5f} px per component, largest {np.abs(error).max():.4f} px")
    print(f"noise floor, sigma = {sigma} grey levels in both images: {floor:.5f} px; ratio {rms / floor:.2f}")


main(Path(sys.argv[1]))

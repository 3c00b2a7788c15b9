"""Compare the measured field and the set-up's motion with those that the images were made from."""

import sys
from pathlib import Path

import numpy as np

from ddic.io.mapping_file import read_mapping_file
from ddic.io.result_reader import read_result
from ddic.synth.truth import load_near_far_truth


def main(folder: Path) -> None:
    truth = load_near_far_truth(folder / "images" / "truth.json")
    mapping = read_mapping_file(folder / "mapping.toml").mapping
    corners = np.array([[0.0, 0.0], [399.0, 0.0], [0.0, 319.0], [399.0, 319.0]])
    off = truth.mapping.to_image(mapping.to_specimen(corners)) - corners
    print(f"calibration: {np.hypot(*off.T).max():.3f} near px off at the worst corner")
    result = read_result(folder / "result.vtkhdf")
    near = result.attributes["near_1"]
    alpha, spread = near["alpha_px"], np.sqrt(np.diag(near["covariance"]))
    print(f"alpha: ({alpha[0]:.4f}, {alpha[1]:.4f}) px, standard deviation ({spread[0]:.4f}, {spread[1]:.4f}) px, "
          f"exact {truth.motion.alpha}")
    error = result.displacement - truth.displacement(result.mesh.nodes)
    for camera, name in enumerate(("far", "near")):
        nodes = result.mesh.create_submesh(np.flatnonzero(result.cell_data["Camera"] == camera))[1]
        print(f"{name} field: RMS error {np.sqrt((error[nodes] ** 2).mean()):.5f} far px per component")


main(Path(sys.argv[1]))

"""Compare the measured strains of the beam with those that the images were made from."""

import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.io.result_reader import read_result
from ddic.synth.truth import load_truth

XX, YY, XY = 0, 1, 3
"""Places of the plane components in VTK's symmetric tensors."""

FROM_ENDS = 60
"""Pixels at both ends that are left out: nothing holds the noise of nodes that are not controlled."""


def exact_strain(folder: Path, points: NDArray[np.float64]) -> NDArray[np.float64]:
    gradient = load_truth(folder / "images" / "truth.json").gradient(points)
    return 0.5 * (gradient + gradient.transpose(0, 2, 1))


def main(folder: Path, wavelengths: list[str]) -> None:
    terms = json.loads((folder / "images" / "truth.json").read_text())["field"]["terms"]
    beam = next(term for term in terms if term["name"] == "bending")
    print("l_c [px]  RMS error of exx       eyy       exy  curvature [1/px]  error [%]")
    for wavelength in wavelengths:
        result = read_result(folder / f"beam_{wavelength}.vtkhdf")
        centres = result.mesh.centroids
        measured = result.cell_data["strain_infinitesimal"][:, [XX, YY, XY]]
        exact = exact_strain(folder, centres)
        x = result.mesh.nodes[:, 0]
        inner = (centres[:, 0] > x.min() + FROM_ENDS) & (centres[:, 0] < x.max() - FROM_ENDS)
        error = measured - np.column_stack([exact[:, 0, 0], exact[:, 1, 1], exact[:, 0, 1]])
        rms = np.sqrt((error[inner] ** 2).mean(axis=0))
        # exx = -curvature (y - y_centre): the slope of the axial strain across the height.
        curvature = -np.polyfit(centres[inner, 1] - beam["center"][1], measured[inner, 0], 1)[0]
        percent = 100 * abs(curvature / beam["curvature"] - 1)
        print(f"{wavelength:>8}  {rms[0]:16.2e}  {rms[1]:8.2e}  {rms[2]:8.2e}  {curvature:16.4e}  {percent:9.3f}")


main(Path(sys.argv[1]), sys.argv[2:])

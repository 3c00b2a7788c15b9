"""Identify parameters of a model of one's own from two images.

A plate with a round hole is pulled along y. The model is Kirsch's solution here; it could as well start a finite
element program and read its displacements: a function of the mesh and the parameters that gives those of the nodes. It
is differentiated by differences. Sought are Poisson's ratio, the strain far away and the motion of the plate, with the
standard deviations that the images' noise leaves.

    python examples/own_model.py

prints

    poisson_ratio: 0.328483 +- 0.000746, true 0.33
    strain: 0.004999 +- 0.000003, true 0.005
    chi^2 of the model beside the field: 1.0
"""

import tempfile
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

import ddic
from ddic.synth.fields import Kirsch

CENTRE, RADIUS = (199.5, 199.5), 50.0
TRUE = {"poisson_ratio": 0.33, "strain": 0.005}

CASE = """
[images]
reference = "f.tif"
deformed = "g.tif"
[mesh.structured]
region = [25, 25, 375, 375]
element_size = 14
circles = [{ center = [199.5, 199.5], radius = 50 }]
"""


def simulate(mesh: ddic.Mesh, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
    """Displacement of the nodes, (n_nodes, 2), pixels."""
    poisson_ratio, strain, *translation = parameters
    return Kirsch(CENTRE, RADIUS, strain, poisson_ratio, tuple(translation)).displacement(mesh.nodes)


folder = Path(tempfile.mkdtemp())
plate = Kirsch(CENTRE, RADIUS, TRUE["strain"], TRUE["poisson_ratio"], (0.3, -0.2))
f, g = ddic.make_synthetic_pair(plate, (400, 400), noise=2, seed=12, hole={"center": CENTRE, "radius": RADIUS})
tifffile.imwrite(folder / "f.tif", f)
tifffile.imwrite(folder / "g.tif", g)
(folder / "case.toml").write_text(CASE)
result = ddic.identify(folder / "case.toml", simulate, {"poisson_ratio": 0.25, "strain": 0.004, "x": 0.0, "y": 0.0})

table = result.identified
for name, value, deviation in zip(TRUE, table["value"], table["deviation"], strict=False):
    print(f"{name}: {value:.6f} +- {deviation:.6f}, true {TRUE[name]}")
print(f"chi^2 of the model beside the field: {result.compared_regions['chi_squared'][0]:.1f}")

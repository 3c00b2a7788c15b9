"""Compare the four ways to solve: they differ in time and memory, not in the field.

"dual" couples subdomains by the forces between them and is made for many ranks; "assembled" and "monolithic" factorise
the whole matrix, over all ranks or on one; "conjugate_gradient" factorises nothing. With tight tolerances they agree to
rounding; with the usual ones, to far less than the noise.

    python examples/methods_compared.py

prints the largest difference from the field of "monolithic", which rounding makes differ from machine to machine:

    assembled: 4e-16 px
    conjugate_gradient: 1e-13 px
    dual: 4e-12 px
"""

import numpy as np
from numpy.typing import NDArray

import ddic


def bend(points: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y = (points - np.array([150, 100])).T
    return 5e-5 * np.column_stack([-x * y, 0.5 * (x**2 + 0.3 * y**2)])


images = ddic.make_synthetic_pair(bend, (300, 200), noise=2, seed=10)
mesh = ddic.structured_mesh((20, 20, 280, 180), element_size=10)


def measure(solver: dict[str, object]) -> NDArray[np.float64]:
    result = ddic.measure(
        images, mesh, regularization={"cut_off_wavelength": 60}, solver=solver,
        gauss_newton={"tolerance": 1e-13, "rms_tolerance": 1e-11})  # far tighter than the noise asks for
    return result.displacement


reference = measure({"method": "monolithic"})
solvers: list[dict[str, object]] = [
    {"method": "assembled", "subdomains": 6},
    {"method": "conjugate_gradient", "subdomains": 6, "tolerance": 1e-12},
    {"method": "dual", "subdomains": 6, "tolerance": 1e-12},
]
for solver in solvers:
    found = measure(solver)
    print(f"{solver['method']}: {np.abs(found - reference).max():.0e} px")

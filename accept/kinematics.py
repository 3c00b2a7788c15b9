"""Kinematics of one's own, from examples/: the same field by every method, on every number of ranks.

Under MPI, as python -m accept.kinematics EXAMPLE METHOD SECTIONS OUTPUT, with a JSON object of further sections of a
case, it measures as an example does and keeps the displacement.
"""

from __future__ import annotations

import importlib.util
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

import ddic
from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import ROOT, run_job

JOB = "accept.kinematics"
BOUND_PX = 1e-9
"""Largest difference of a displacement component between methods and rank counts, pixels."""

MOST_LINES = 60
"""Lines of the example of integrated DIC are fewer."""

RANKS = (1, 2, 3, 4)
CONVERGED = {"gauss_newton": {"tolerance": 1e-13, "rms_tolerance": 1e-12, "max_iterations": 100},
             "solver": {"method": "dual", "tolerance": 1e-12, "inexact": False}}
"""Sections of a case by which only rounding is left between methods."""


@dataclass(frozen=True)
class Example:
    """An example with kinematics of its own.

    Attributes
    ----------
    name : str
        Of its file in examples/.
    what : str
        Its unknowns, in words.
    methods : tuple of str
        Values of solver.method that run on any number of ranks; ``monolithic`` on one rank is what they are compared
        with.
    """

    name: str
    what: str
    methods: tuple[str, ...]

    @property
    def path(self) -> Path:
        """Its file."""
        return ROOT / "examples" / f"{self.name}.py"


INTEGRATED = Example("integrated_dic", "rigid motion, affine strain and six bending modes of the whole region",
                     ("dual", "assembled", "conjugate_gradient"))
FIXED = Example("fixed_components", "every third node fixed along y", ("dual", "assembled", "conjugate_gradient"))


def measure_integrated(scale: Scale) -> list[Row]:
    """Compare methods and ranks on integrated DIC, and count the example's lines."""
    rows = _compare(INTEGRATED, scale)
    n_lines = len(INTEGRATED.path.read_text(encoding="utf-8").splitlines())
    return [*rows, Row("integrated DIC as a page of examples/", f"fewer than {MOST_LINES} lines", f"{n_lines} lines",
                       n_lines < MOST_LINES)]


def measure_fixed_components(scale: Scale) -> list[Row]:
    """Compare methods and ranks where the number of unknowns differs from node to node."""
    return _compare(FIXED, scale)


def _compare(example: Example, scale: Scale) -> list[Row]:
    """Largest difference of every method on every number of ranks from monolithic."""
    folder = scale.folder("kinematics")
    folder.mkdir(parents=True, exist_ok=True)
    reference = _measure(example, "monolithic", 1, folder)
    methods: Sequence[str] = example.methods[:1] if scale.smoke else example.methods
    ranks = (2,) if scale.smoke else RANKS
    largest = {method: max(float(np.abs(_measure(example, method, n, folder) - reference).max()) for n in ranks)
               for method in methods}
    for method, value in largest.items():
        append_result("kinematics_runs", {"example": example.name, "method": method, "largest_difference_px": value})
    return [Row(f"own kinematics, examples/{example.name}.py: {example.what}; on {', '.join(map(str, ranks))} ranks "
                "against monolithic", f"same field to {BOUND_PX:.0e} px",
                ", ".join(f"{method} {value:.1e} px" for method, value in largest.items()),
                max(largest.values()) <= BOUND_PX)]


def _measure(example: Example, method: str, n_ranks: int, folder: Path) -> NDArray[np.float64]:
    """Displacement of all nodes, pixels."""
    output = folder / f"{example.name}_{method}_{n_ranks}.npy"
    output.unlink(missing_ok=True)
    run_job(n_ranks, JOB, str(example.path), method, json.dumps(CONVERGED), str(output))
    return np.asarray(np.load(output))


N_SUBDOMAINS = 4
"""As in the examples: as many as the largest number of ranks."""


def load_example(path: Path) -> ModuleType:
    """Import an example, whose own measurement is not run."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} cannot be imported")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main(example: str, method: str, sections: str, output: str) -> None:
    """Measure on all ranks; rank 0 writes."""
    module = load_example(Path(example))
    settings = json.loads(sections)
    cut = {} if method == "monolithic" else {"subdomains": N_SUBDOMAINS}
    settings["solver"] = {**settings.get("solver", {}), "method": method, **cut}
    result = ddic.measure(module.IMAGES, module.MESH, kinematics=module.kinematics, **settings)
    if MPI.COMM_WORLD.rank == 0:
        np.save(output, result.displacement)


if __name__ == "__main__":
    main(*sys.argv[1:])

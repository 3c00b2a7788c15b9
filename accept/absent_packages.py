"""PETSc without CHOLMOD, without MUMPS, without both: the same field by what is there, or a line that says why not."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accept.support.launcher_lines import drop_launcher_lines
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ROOT, TIMEOUT_S, ddic_run, environment, images
from ddic.io.result_reader import read_result

SAME_PX = 1e-8
"""Linear systems are solved to 1e-12 of displacements of half a pixel; condition numbers stay below 1e3."""

ABSENT = ("suitesparse", "mumps", "suitesparse,mumps")
ALL = "all"
"""In place of what is absent."""
SOLVERS = {
    "dual, scaled": 'method = "dual"\npreconditioner = "scaled"\nsubdomains = 9',
    "dual, two_level": 'method = "dual"\npreconditioner = "two_level"\nsubdomains = 9',
    "dual, sparse inverses": 'method = "dual"\nlocal_inverse = "sparse"\nsubdomains = 9',
    "assembled": 'method = "assembled"',
    "conjugate_gradient": 'method = "conjugate_gradient"',
    "monolithic": 'method = "monolithic"',
}


def measure_absent_packages(scale: Scale) -> list[Row]:
    """Run every solver on one and two ranks with packages taken away.

    Parameters
    ----------
    scale : Scale
        A smoke run takes one solver on one rank.

    Returns
    -------
    list of Row
        One for each set of absent packages.
    """
    folder = scale.folder("absent_packages")
    images("kirsch", "--size", "300x300", "--strain", "0.005", "--radius", "30", "--seed", "1",
           folder=folder / "images")
    ddic_run(_case(SOLVERS["monolithic"]), folder, 1, ALL)
    field = read_result(folder / f"{ALL}.vtkhdf").fields["displacement"]
    solvers = ["dual, two_level"] if scale.smoke else list(SOLVERS)
    ranks = [1] if scale.smoke else [1, 2]
    runs = [run for run in product(solvers, ranks) if run != ("monolithic", 2)]
    return [_measure_without(absent, runs, folder, field) for absent in (ABSENT[1:2] if scale.smoke else ABSENT)]


def _case(solver: str) -> str:
    tolerances = "" if '"assembled"' in solver or '"monolithic"' in solver else "tolerance = 1e-12\ninexact = false\n"
    return ('[images]\nreference = "images/reference.tif"\ndeformed = "images/deformed.tif"\n'
            "[mesh.structured]\nregion = [20, 20, 280, 280]\nelement_size = 10\n"
            "circles = [{ center = [149.5, 149.5], radius = 30 }]\n"
            '[regularization]\ncut_off_wavelength = 60\nnot_controlled = ["left", "right", "top", "bottom"]\n'
            f"[gauss_newton]\ntolerance = 1e-9\nrms_tolerance = 0\n[solver]\n{solver}\n{tolerances}")


def _measure_without(absent: str, runs: list[tuple[str, int]], folder: Path, field: NDArray[np.float64]) -> Row:
    largest, refused, wrong = 0.0, [], []
    for name, n_ranks in runs:
        stem = f"{name}_{n_ranks}".replace(", ", "_").replace(" ", "_")
        case = folder / f"{stem}.toml"
        case.write_text(f'{_case(SOLVERS[name])}[output]\nfile = "{stem}.vtkhdf"\n', encoding="utf-8")
        (folder / f"{stem}.vtkhdf").unlink(missing_ok=True)
        code, said = _run(absent, case, n_ranks)
        if code == 0:
            difference = read_result(folder / f"{stem}.vtkhdf").fields["displacement"] - field
            largest = max(largest, float(np.abs(difference).max()))
        elif code == 2 and len(said) == 1 and "PETSc was built without" in said[0]:
            refused.append(f"{name} on {n_ranks}")
        else:
            wrong.append(f"{name} on {n_ranks}: exit code {code}, {len(said)} lines")
    n_measured = len(runs) - len(refused) - len(wrong)
    measured = (f"{n_measured} of {len(runs)} runs measured, off by {largest:.1e} px at most; refused by "
                f"one line: {', '.join(refused) or 'none'}" + "".join(f"; WRONG: {line}" for line in wrong))
    return Row(f"PETSc without {absent.replace(',', ' and ')}: every solver on 1 and 2 ranks",
               f"the field of all packages within {SAME_PX:g} px, or one line and exit code 2", measured,
               not wrong and largest <= SAME_PX)


def _run(absent: str, case: Path, n_ranks: int) -> tuple[int, list[str]]:
    """Exit code, and what ddic itself says on standard error."""
    launcher = os.environ.get("MPIEXEC", "mpiexec")
    done = subprocess.run(["timeout", str(TIMEOUT_S), launcher, "-n", str(n_ranks), sys.executable, "-m",
                           "bench.support.absent_packages", absent, "run", str(case)], cwd=ROOT, text=True,
                          env=environment(), capture_output=True, check=False)
    return done.returncode, drop_launcher_lines(done.stderr)

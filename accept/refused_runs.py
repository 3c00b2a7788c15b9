"""Runs without CHOLMOD or MUMPS, over an older result, with two cases or mistyped options: what stays and is said."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accept.support.ended_job import drop_launcher_lines
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ROOT, TIMEOUT_S, ddic_command, ddic_run, environment, images
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
    """Run every solver on one and two ranks with packages taken away."""
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
        code, said = _run_without(absent, case, n_ranks)
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


def _run_without(absent: str, case: Path, n_ranks: int) -> tuple[int, list[str]]:
    """Exit code, and what ddic itself says on standard error."""
    launcher = os.environ.get("MPIEXEC", "mpiexec")
    done = subprocess.run(["timeout", str(TIMEOUT_S), launcher, "-n", str(n_ranks), sys.executable, "-m",
                           "bench.support.absent_packages", absent, "run", str(case)], cwd=ROOT, text=True,
                          env=environment(), capture_output=True, check=False)
    return done.returncode, drop_launcher_lines(done.stderr)


OPTION = "-dual_kps_rtol"
"""For -dual_ksp_rtol."""

SHOWN = 160
"""Characters of what was said that a row shows."""

_GOOD = ('[images]\nreference = "images/reference.tif"\ndeformed = "images/deformed.tif"\n'
         "[mesh.structured]\nregion = [20, 20, 220, 220]\nelement_size = 20\n"
         '[solver]\nmethod = "dual"\nsubdomains = 4\n')
"""Solved by the method whose option is mistyped: another one has no use for it, spelt right or not."""

_FAILS = _GOOD + "[gauss_newton]\nmax_iterations = 1\n[start]\nrigid = false\npyramid = false\nindependent = false\n"


def measure_refused_runs(scale: Scale) -> list[Row]:
    """Run ``ddic run`` as a user does who mistypes, or whose images do not match."""
    folder = scale.folder("refused_runs")
    images("translation", "--vector", "1.3", "-0.7", "--size", "240x240", "--seed", "3", folder=folder / "images")
    for left in (*folder.glob("result*"), *folder.glob("other*")):
        left.unlink()
    return [_fail_over_older_result(folder), _name_two_cases(folder), _mistype_an_option(folder)]


def _run(folder: Path, case: str, *arguments: str) -> tuple[int, str]:
    """Exit code, and all that is printed."""
    (folder / "case.toml").write_text(f'{case}[output]\nfile = "result.vtkhdf"\n', encoding="utf-8")
    done = subprocess.run([ddic_command(), "run", "case.toml", *arguments], cwd=folder, env=environment(), text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
    return done.returncode, done.stdout


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob("result*"))


def _converged(folder: Path, name: str) -> object:
    path = folder / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8"))["converged"] if path.is_file() else None


def _fail_over_older_result(folder: Path) -> Row:
    good, _ = _run(folder, _GOOD)
    failed, printed = _run(folder, _FAILS)
    names = _names(folder)
    states = {name: _converged(folder, name) for name in ("result", "result.earlier", "result.not_converged")}
    last = printed.strip().splitlines()[-1]
    as_said = {"result": None, "result.earlier": True, "result.not_converged": False}
    held = (good, failed) == (0, 1) and "result.vtkhdf" not in names and states == as_said and "not_converged" in last
    return Row("a run that does not converge, over an older result",
               "exit code 1; the older result is called earlier; the last field is marked; its name is said",
               f"exit codes {good}, {failed}; converged: {states}; {len(names)} files; "
               f"{'the line names the last field' if 'not_converged' in last else last[:SHOWN]}", held)


def _name_two_cases(folder: Path) -> Row:
    (folder / "other.toml").write_text(_GOOD, encoding="utf-8")
    before = {path: path.stat().st_mtime_ns for path in folder.glob("result*")}
    code, printed = _run(folder, _GOOD, "other.toml")
    untouched = before == {path: path.stat().st_mtime_ns for path in folder.glob("result*")}
    said = printed.strip().splitlines()
    return Row("ddic run case.toml other.toml", "exit code 2, one line that names the second, nothing written",
               f"exit code {code}; {'nothing' if untouched else 'something'} written; {len(said)} line: "
               f"{' '.join(said)[:SHOWN]}", code == 2 and untouched and len(said) == 1 and "other.toml" in said[0])


def _mistype_an_option(folder: Path) -> Row:
    code, printed = _run(folder, _GOOD, OPTION, "1e-3")
    said = [line for line in printed.splitlines() if OPTION in line]
    right, silent = _run(folder, _GOOD, OPTION.replace("kps", "ksp"), "1e-3")
    n_false = sum("never asked for" in line for line in silent.splitlines())
    return Row(f"ddic run case.toml {OPTION} 1e-3", "one warning that names it; none where it is spelt right",
               f"exit code {code}, {len(said)} line: {' '.join(said)[:SHOWN]}; spelt right: exit code {right}, "
               f"{n_false} warnings", len(said) == 1 and n_false == 0 and (code, right) == (0, 0))

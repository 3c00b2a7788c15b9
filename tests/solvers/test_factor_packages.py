"""What ``ddic run`` does with a PETSc that has no CHOLMOD, no MUMPS, or neither."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import ddic
from ddic.solvers.petsc import choose_local_package, describe_missing_packages, has_package, require_packages
from support.cases import write_case, write_images
from support.commands import DDIC, Finished, finished

ROOT = Path(__file__).parents[2]
TIGHT = "[regularization]\ncut_off_wavelength = 48.0\n[gauss_newton]\ntolerance = 1e-9\nrms_tolerance = 0\n"
SOLVERS = {
    "dual": 'subdomains = 4\npreconditioner = "two_level"\ntolerance = 1e-12\ninexact = false\n',
    "assembled": 'method = "assembled"\n',
    "monolithic": 'method = "monolithic"\n',
    "sparse": 'subdomains = 4\nlocal_inverse = "sparse"\n',
}
SAME_PX = 1e-8
"""Linear systems are solved to 1e-12 of displacements of half a pixel; condition numbers stay below 1e3."""
ABSENT = [("suitesparse",), ("mumps",), ("suitesparse", "mumps")]

pytestmark = pytest.mark.skipif(not (choose_local_package() == "cholmod" and has_package("mumps")),
                                reason="needs a PETSc with both packages, to take them away")


def _run(folder: Path, solver: str, absent: Sequence[str], ranks: int, *options: str) -> Finished:
    folder.mkdir(exist_ok=True)
    write_images(folder)
    write_case(folder, f"{TIGHT}[solver]\n{SOLVERS[solver]}")
    environment = [f"PYTHONPATH={ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"]
    if options:
        environment.append(f"PETSC_OPTIONS={' '.join(options)}")
    command = [sys.executable, "-m", "bench.support.absent_packages", ",".join(absent)] if absent else DDIC
    return finished(["env", *environment, *command, "run", str(folder / "case.toml")], ranks)


@pytest.fixture(scope="module")
def displacement(tmp_path_factory: pytest.TempPathFactory) -> NDArray[np.float64]:
    """The field of the whole problem, with all packages."""
    folder = tmp_path_factory.mktemp("all")
    job = _run(folder, "monolithic", (), 0)
    assert job.code == 0, job.err
    return ddic.open(folder / "result.vtkhdf").displacement


@pytest.mark.program
@pytest.mark.parametrize(("solver", "ranks", "absent"), [
    ("dual", 2, ABSENT[0]), ("dual", 2, ABSENT[1]), ("dual", 0, ABSENT[2]), ("assembled", 0, ABSENT[1]),
    ("assembled", 0, ABSENT[2]), ("monolithic", 0, ABSENT[2])])
def test_the_field_is_measured_with_what_is_there(tmp_path: Path, solver: str, ranks: int, absent: tuple[str, ...],
                                                  displacement: NDArray[np.float64]) -> None:
    job = _run(tmp_path / "run", solver, absent, ranks)
    assert job.code == 0, job.err
    found = ddic.open(tmp_path / "run" / "result.vtkhdf").displacement
    assert np.abs(found - displacement).max() < SAME_PX
    told = [line for line in job.out.splitlines() if line.startswith("PETSc was built without")]
    local, mumps = solver in ("dual", "monolithic"), solver in ("dual", "assembled")
    assert len(told) == (local and "suitesparse" in absent) + (mumps and "mumps" in absent)


@pytest.mark.program
@pytest.mark.parametrize(("solver", "ranks", "words"), [
    ("assembled", 2, ('solver.method = "assembled"', "2 MPI ranks", '"conjugate_gradient"')),
    ("sparse", 0, ('solver.local_inverse = "sparse"', '"auto"')),
])
def test_what_needs_mumps_is_refused_by_one_line(tmp_path: Path, solver: str, ranks: int, words: Sequence[str]) -> None:
    folder = tmp_path / "run"
    job = _run(folder, solver, ("mumps",), ranks)
    assert job.code == 2
    assert len(job.errors) == 1, job.err
    assert all(word in job.errors[0] for word in ("case.toml: ", "MUMPS", *words))
    assert sorted(path.name for path in folder.iterdir()) == ["case.toml", "f.tif", "g.tif"]


@pytest.mark.program
@pytest.mark.skipif(not has_package("superlu_dist"), reason="needs another parallel package")
def test_a_package_that_the_user_names_is_taken(tmp_path: Path, displacement: NDArray[np.float64]) -> None:
    options = ("-assembled_pc_type", "lu", "-assembled_pc_factor_mat_solver_type", "superlu_dist")
    job = _run(tmp_path / "run", "assembled", ("mumps",), 2, *options)
    assert job.code == 0, job.err
    assert "built without" not in job.out
    found = ddic.open(tmp_path / "run" / "result.vtkhdf").displacement
    assert np.abs(found - displacement).max() < SAME_PX


@pytest.mark.parametrize("method", ["dual", "assembled", "monolithic", "conjugate_gradient"])
def test_nothing_is_told_or_refused_where_petsc_has_both(method: str) -> None:
    assert describe_missing_packages(method) == ()
    require_packages("case.toml", method, "sparse", 4)

"""``import ddic`` costs nothing and offers what it says."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import ddic

ROOT = Path(__file__).parents[2]


def run_python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
                          capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_import_alone_brings_no_library() -> None:
    assert run_python("import sys, ddic; ddic.__version__; dir(ddic); "
                      "print(*{'numpy', 'mpi4py', 'petsc4py', 'numba', 'h5py', 'pydantic'} & set(sys.modules))") == ""


def test_errors_and_meshes_need_no_mpi() -> None:
    assert run_python("import sys, ddic; ddic.InputError; ddic.structured_mesh((0, 0, 9, 9), 3); ddic.open; "
                      "print(*{'mpi4py', 'petsc4py'} & set(sys.modules))") == ""


@pytest.mark.parametrize("name", ddic.__all__)
def test_every_public_name_exists_and_is_described(name: str) -> None:
    found = getattr(ddic, name)
    assert name in dir(ddic)
    assert name == "__version__" or found.__doc__


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'mesure'"):
        _ = ddic.mesure


def test_measures_in_one_process_without_a_launcher() -> None:
    code = """
import numpy as np, ddic
images = ddic.make_synthetic_pair(lambda points: np.full_like(points, 0.3), (120, 100), seed=2)
result = ddic.measure(images, ddic.structured_mesh((20, 20, 100, 80), 20))
print(abs(result.displacement - 0.3).max() < 0.01, result)
"""
    printed = run_python(code)
    # What a notebook shows is one line, whatever the size of the mesh.
    assert printed.startswith("True <ddic.Result in memory: trust, 20 nodes, 12 cells, 1 subdomains, ")
    assert "\n" not in printed

"""What set-up compiles is all that a run needs."""

from __future__ import annotations

import os
import re
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from ddic.io.mesh_file import write_mesh
from support.cases import write_case, write_images
from support.commands import ddic, finished
from support.random_meshes import box_mesh
from support.volumes import make_pair

pytestmark = pytest.mark.program

MORE = """
[correlation]
grey_correction = "element"
[regularization]
cut_off_wavelength = 48.0
[solver]
subdomains = 3
"""

TRIANGLES = """cell = "T3"
circles = [{ center = [96, 96], radius = 24 }]
"""

SIGNATURES = """
import sys
from pathlib import Path
import petsc4py
petsc4py.init(["ddic"])
from mpi4py import MPI
from numba.core.dispatcher import Dispatcher
from ddic.compile_kernels import compile_kernels
from ddic.results.listener import Silence
from ddic.methods.run import run_case
from ddic.parallel.team import Team


def kernels():
    modules = [m for name, m in sys.modules.items() if name.startswith("ddic.")]
    found = {id(v): v for m in modules for v in vars(m).values() if isinstance(v, Dispatcher)}
    return {f"{k.py_func.__module__}.{k.py_func.__name__}": k for k in found.values()}


compile_kernels()
before = {name: list(k.signatures) for name, k in kernels().items()}
for case in sys.argv[1:]:
    run_case(Team(MPI.COMM_SELF), Path(case), Silence())
called = {name: k for name, k in kernels().items() if k.signatures}
print("called", len(called))
print("new:", [name for name, k in called.items() if k.signatures != before.get(name)])
print("not kept:", [name for name, k in called.items() if k.stats.cache_path is None])
"""


OF_VOLUMES = """
[volumes]
reference = "before.tif"
deformed = "after.tif"
[mesh]
file = "tetrahedra.vtu"
[output]
file = "volume.vtkhdf"
"""


def _cases(folder: Path) -> list[Path]:
    """A TIFF pair on Q4, a PNG pair on triangles around a hole without the saturated pixels, volumes on tetrahedra.

    The last again, under a light that varies.
    """
    write_images(folder)
    for name in ("f", "g"):
        cv2.imwrite(str(folder / f"{name}.png"), tifffile.imread(folder / f"{name}.tif"))
    first = write_case(folder, MORE)
    second = folder / "png.toml"
    text = first.read_text().replace(".tif", ".png").replace("[images]", "[images]\nexclude_saturated = true")
    second.write_text(text.replace("element_size", TRIANGLES + "element_size") + '[output]\nfile = "p.vtkhdf"\n')
    before, after = make_pair(40)
    lit = after + np.linspace(0.0, 40.0, after.shape[2])
    for name, values in (("before", before), ("after", after), ("lit", lit)):
        tifffile.imwrite(folder / f"{name}.tif", values.round().clip(0, 255).astype(np.uint8))
    mesh = box_mesh(0, "Tet4", (4, 3, 3), 0.0)
    write_mesh(folder / "tetrahedra.vtu", replace(mesh, nodes=mesh.nodes + 12.0))
    third = folder / "volumes.toml"
    third.write_text(OF_VOLUMES)
    fourth = folder / "lit.toml"
    fourth.write_text(OF_VOLUMES.replace("after", "lit").replace("volume.vtkhdf", "lit.vtkhdf"))
    return [first, second, third, fourth]


def test_runs_of_other_cases_compile_nothing_more(tmp_path: Path) -> None:
    job = finished([sys.executable, "-c", SIGNATURES, *map(str, _cases(tmp_path))])
    assert job.code == 0, job.err
    assert int(re.findall(r"called (\d+)", job.out)[0]) >= 4
    assert "new: []" in job.out
    assert "not kept: []" in job.out


def test_a_start_after_set_up_takes_all_kernels_from_the_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = finished([sys.executable, "-m", "ddic.compile_kernels"])
    assert job.code == 0, job.err
    assert "kernels compiled in" in job.out
    monkeypatch.setitem(os.environ, "NUMBA_DEBUG_CACHE", "1")
    case = _cases(tmp_path)[0]
    for ranks in (0, 2):
        job = ddic("run", case, ranks=ranks)
        assert job.code == 0, job.err
        assert "data loaded from" in job.out
        assert "data saved to" not in job.out

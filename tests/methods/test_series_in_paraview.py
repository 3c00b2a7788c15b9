"""A series that was run on one and two ranks plays in VTK's reader: times and displacements of each frame."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import tifffile
from mpi4py import MPI
from numpy.typing import NDArray

import ddic
from ddic.io.series_reader import read_series
from ddic.methods.run import run_file
from ddic.parallel.team import Team
from ddic.results.listener import Silence

vtk = pytest.importorskip("vtk")
numpy_support = pytest.importorskip("vtk.util.numpy_support")

TIMES = [0.5, 2.0, 3.5]
CASE = """[images]
reference = "reference.tif"
deformed = "frame_*.tif"
deformed_time = [0.5, 2.0, 3.5]
[mesh.structured]
region = [16, 16, 112, 112]
element_size = 16
[solver]
method = "dual"
subdomains = 3
"""


def stretch(points: NDArray[np.float64], time: float) -> NDArray[np.float64]:
    return np.asarray(0.004 * time * (points - 64))


def write_inputs(folder: Path) -> None:
    for number, time in enumerate(TIMES, start=1):
        reference, deformed = ddic.make_synthetic_pair(partial(stretch, time=time), (128, 128), seed=5)
        tifffile.imwrite(folder / "reference.tif", reference)
        tifffile.imwrite(folder / f"frame_{number}.tif", deformed)
    (folder / "case.toml").write_text(CASE, encoding="utf-8")


@pytest.mark.parallel([1, 3])
def test_a_measured_series_plays(tmp_path: Path) -> None:
    comm = MPI.COMM_WORLD
    folder = comm.bcast(tmp_path)
    if comm.rank == 0:
        write_inputs(folder)
    comm.barrier()
    run_file(Team.world(), folder / "case.toml", Silence())
    if comm.rank != 0:
        return
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(folder / "result.vtkhdf"))
    series = read_series(folder / "result.vtkhdf")
    assert series.times.tolist() == TIMES
    for time, result in zip(TIMES, series, strict=True):
        reader.UpdateTimeStep(time)
        whole = reader.GetOutputDataObject(0)
        assert whole.GetNumberOfPartitions() == 3
        for k in range(3):
            data = whole.GetPartition(k).GetPointData()
            u = numpy_support.vtk_to_numpy(data.GetArray("displacement"))[:, :2]
            nodes = numpy_support.vtk_to_numpy(data.GetArray("GlobalNodeId"))
            np.testing.assert_array_equal(u, result.displacement[nodes])
            # 8 bit leave some thousandths of a pixel on 16-px elements; frames differ by 0.2 px and more.
            np.testing.assert_allclose(u, stretch(result.mesh.nodes[nodes], time), atol=0.03)

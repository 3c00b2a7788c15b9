"""VTK's reader, which is ParaView's, plays series: at each time the geometry and fields of its frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.io.result_schema import physical_path
from ddic.mesh.structured import build_structured_mesh
from support.series_files import FrameFile, displace, write_series_file

vtk = pytest.importorskip("vtk")
numpy_support = pytest.importorskip("vtk.util.numpy_support")

FINE = build_structured_mesh((10.0, 10.0, 50.0, 30.0), 5.0)
SERIES: dict[str, list[FrameFile]] = {
    "one part": [FrameFile(0.5, 1), FrameFile(1.0, 1)],
    "several parts": [FrameFile(0.5, 3), FrameFile(1.0, 3), FrameFile(4.0, 3)],
    "other parts": [FrameFile(0.5, 2), FrameFile(1.0, 3), FrameFile(2.0, 1), FrameFile(3.0, 2), FrameFile(4.0, 2)],
    "not all measured": [FrameFile(0.5, 0), FrameFile(1.0, 3), FrameFile(2.0, 0), FrameFile(3.0, 3)],
    "another mesh": [FrameFile(0.5, 2), FrameFile(1.0, 2, FINE), FrameFile(2.0, 3, FINE)],
}


class Played:
    """A series as VTK reads it."""

    def __init__(self, path: Path) -> None:
        self.reader = vtk.vtkHDFReader()
        self.reader.SetFileName(str(path))
        self.errors: list[str] = []
        self.reader.AddObserver("ErrorEvent", lambda *_: self.errors.append("error"))
        self.reader.UpdateInformation()
        information = self.reader.GetOutputInformation(0)
        key = vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS()
        self.times = [information.Get(key, k) for k in range(information.Length(key))]

    def parts(self, time: float) -> list[Any]:
        self.reader.UpdateTimeStep(time)
        assert self.errors == []
        whole = self.reader.GetOutputDataObject(0)
        # One part alone in the whole file is a grid of its own.
        if not hasattr(whole, "GetNumberOfPartitions"):
            return [whole]
        return [whole.GetPartition(k) for k in range(whole.GetNumberOfPartitions())]


def array(data: Any, name: str) -> NDArray[np.float64]:
    found: NDArray[np.float64] = numpy_support.vtk_to_numpy(data.GetArray(name))
    return found


def points_of(part: Any) -> NDArray[np.float64]:
    points: NDArray[np.float64] = numpy_support.vtk_to_numpy(part.GetPoints().GetData())
    return points


def corners_of(part: Any, cell: int) -> NDArray[np.float64]:
    ids = part.GetCell(cell).GetPointIds()
    return points_of(part)[[ids.GetId(k) for k in range(ids.GetNumberOfIds())], :2]


def require_same(parts: Sequence[Any], frame: FrameFile, sign: float) -> None:
    """Geometry and fields are those of a frame; sign: of y in the file."""
    cells = []
    for part in parts:
        points = points_of(part)[:, :2] * [1.0, sign]
        u = array(part.GetPointData(), "displacement")[:, :2] * [1.0, sign]
        np.testing.assert_array_equal(u, displace(points, frame.time))
        np.testing.assert_array_equal(points, frame.mesh.nodes[array(part.GetPointData(), "GlobalNodeId")])
        ids = array(part.GetCellData(), "GlobalCellId")
        for cell, number in enumerate(ids):
            nodes = frame.mesh.connectivity[frame.mesh.offsets[number]:frame.mesh.offsets[number + 1]]
            np.testing.assert_array_equal(corners_of(part, cell) * [1.0, sign], frame.mesh.nodes[nodes])
        np.testing.assert_array_equal(array(part.GetCellData(), "residual_rms"), frame.time + ids / 100)
        cells += ids.tolist()
    assert sorted(cells) == list(range(frame.mesh.n_cells))


@pytest.mark.parametrize("frames", SERIES.values(), ids=SERIES)
@pytest.mark.parametrize("flip_y", [False, True], ids=["down", "up"])
def test_vtk_reads_each_frame_at_its_time(tmp_path: Path, frames: Sequence[FrameFile], flip_y: bool) -> None:
    played = Played(write_series_file(tmp_path / "s.vtkhdf", frames, flip_y=flip_y))
    measured = [frame for frame in frames if frame.n_parts]
    assert played.times == [frame.time for frame in measured]
    for frame in measured:
        parts = played.parts(frame.time)
        assert len(parts) == measured[0].n_parts
        require_same(parts, frame, -1.0 if flip_y else 1.0)


@pytest.mark.parametrize("name", SERIES)
def test_vtk_goes_back_in_time(tmp_path: Path, name: str) -> None:
    measured = [frame for frame in SERIES[name] if frame.n_parts]
    played = Played(write_series_file(tmp_path / "s.vtkhdf", SERIES[name]))
    for frame in (*measured, *measured[::-1], *measured):
        parts = played.parts(frame.time)
        # Those of the first frame, whatever the frame's own were: the reader loses parts where their number changes.
        assert len(parts) == measured[0].n_parts
        assert all(part.GetNumberOfCells() for part in parts)
        require_same(parts, frame, 1.0)


@pytest.mark.parametrize("frames", SERIES.values(), ids=SERIES)
def test_vtk_reads_the_file_in_the_length_unit_alike(tmp_path: Path, frames: Sequence[FrameFile]) -> None:
    path = write_series_file(tmp_path / "s.vtkhdf", frames, length_unit="mm")
    plain, scaled = Played(path), Played(physical_path(path))
    assert scaled.times == plain.times
    for time in plain.times:
        for part, other in zip(plain.parts(time), scaled.parts(time), strict=True):
            np.testing.assert_array_equal(points_of(other), 0.5 * points_of(part))
            u, physical = array(part.GetPointData(), "displacement"), array(other.GetPointData(), "displacement")
            np.testing.assert_array_equal(physical, 0.5 * u)
            assert other.GetNumberOfCells() == part.GetNumberOfCells()

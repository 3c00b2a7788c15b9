from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

import ddic
from ddic.errors import InputError
from ddic.io import hdf5_file
from ddic.io.series_reader import (
    find_displacement_range,
    gather_history,
    is_series_file,
    read_frame,
    read_frame_or_last,
    read_series,
)
from support.series_files import MESH, STRAIN, FrameFile, displace, write_series_file

FRAMES = [FrameFile(0.5), FrameFile(1.0, 0), FrameFile(2.0, 3), FrameFile(3.0), FrameFile(4.0, 0)]


@pytest.fixture
def series(tmp_path: Path) -> Path:
    return write_series_file(tmp_path / "s.vtkhdf", FRAMES, length_unit="mm", flip_y=True)


def test_a_frame_is_read_by_its_number(series: Path) -> None:
    assert is_series_file(series)
    for number in (1, 3, 4):
        result = read_frame(series, number)
        np.testing.assert_array_equal(result.displacement, displace(MESH.nodes, FRAMES[number - 1].time))
        assert result.path == series


@pytest.mark.parametrize(("number", "line"), [
    (2, r"frame 2 was not measured \(the images do not match\); choose one of 1, 3 to 4$"),
    (6, r"frame 6 is none of this series; choose one of 1, 3 to 4$"),
    (None, r"holds the frames 1, 3 to 4 of a series; choose one by --frame$"),
])
def test_frames_that_are_not_there_are_refused_by_a_line(series: Path, number: int | None, line: str) -> None:
    with pytest.raises(InputError, match=line):
        read_frame(series, number)


def test_a_file_is_looked_through_once_as_long_as_it_is_the_same(series: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[Path] = []
    monkeypatch.setattr(hdf5_file, "_require_finite", lambda path, file: looked.append(path))
    frames = read_series(series)
    assert [result.mesh.n_cells for result in frames] == [MESH.n_cells] * 3
    assert looked == [series]
    # Other bytes under the same name.
    series.write_bytes(series.read_bytes() + b"\0")
    assert frames[0].mesh.n_cells == MESH.n_cells
    assert looked == [series, series]


def test_a_pair_has_no_frames(tmp_path: Path, write_result: object) -> None:
    pair = write_result(tmp_path / "r.vtkhdf")  # type: ignore[operator]
    assert not is_series_file(pair)
    assert not is_series_file(tmp_path / "nothing")
    assert read_frame(pair).mesh.n_cells == 15
    with pytest.raises(InputError, match=r"--frame 1: .*r\.vtkhdf is the result of a pair, not of a series"):
        read_frame(pair, 1)


def test_a_measurement_starts_from_the_frame_asked_for_or_the_last(series: Path) -> None:
    result, name = read_frame_or_last(series, 3)
    assert name == f"{series}, frame 3"
    np.testing.assert_array_equal(result.displacement, displace(MESH.nodes, 2.0))
    result, name = read_frame_or_last(series, None)
    assert name == f"{series}, frame 4, the last one that was measured"
    np.testing.assert_array_equal(result.displacement, displace(MESH.nodes, 3.0))
    with pytest.raises(InputError, match=r"^start\.frame = 9: .* is none of this series"):
        read_frame_or_last(series, 9, "start.frame =")


def test_public_names_read_series(series: Path) -> None:
    opened = ddic.open_series(series)
    assert isinstance(opened, ddic.SeriesResult)
    assert len(opened) == 3
    with pytest.raises(InputError, match=r"read it with ddic\.open_series"):
        ddic.open(series)


def test_exports_of_a_frame_are_those_of_a_pair(series: Path) -> None:
    frame = ddic.open_series(series)[1]
    exported = frame.to_meshio()
    np.testing.assert_array_equal(exported.points[:, :2], MESH.nodes)
    np.testing.assert_array_equal(exported.point_data["displacement"][:, :2], displace(MESH.nodes, 2.0))
    assert len(exported.cells_dict["quad"]) == MESH.n_cells
    pytest.importorskip("pyvista")
    grid = frame.to_pyvista()
    assert grid.n_cells == MESH.n_cells
    np.testing.assert_array_equal(grid.cell_data["residual_rms"], 2.0 + np.arange(MESH.n_cells) / 100)


def test_range_is_that_of_all_frames(series: Path) -> None:
    low, high = find_displacement_range(read_series(series))
    # The last measured frame moves farthest: 3 times 1 % of 10 to 50 px, the first least.
    np.testing.assert_allclose(low, [0.5 * STRAIN * 10, -0.5 * 3 * STRAIN * 30])
    np.testing.assert_allclose(high, [3 * STRAIN * 50, -0.5 * 0.5 * STRAIN * 10])


def test_history_is_that_of_the_fields(series: Path) -> None:
    history = gather_history(read_series(series))
    assert history.is_measured.tolist() == [True, False, True, True, False]
    assert history.times.tolist() == [0.5, 1.0, 2.0, 3.0, 4.0]
    for row, time in ((0, 0.5), (2, 2.0), (3, 3.0)):
        u = displace(MESH.nodes, time)
        np.testing.assert_allclose(history.lowest[row], u.min(axis=0))
        np.testing.assert_allclose(history.highest[row], u.max(axis=0))
        np.testing.assert_allclose(history.mean[row], u.mean(axis=0))
        # The same strain everywhere: its mean is itself, whatever the areas.
        np.testing.assert_allclose(history.principal_strains[row], [time * STRAIN, -0.5 * time * STRAIN])
        assert history.iterations[row] == 3 + row
    for values in (history.mean, history.principal_strains, history.residual, history.noise_floor, history.iterations):
        assert np.isnan(values[[1, 4]]).all()


def test_mean_strain_counts_areas() -> None:
    from ddic.io.series_reader import _average
    from ddic.mesh.cell_type import Q4
    from ddic.mesh.mesh import build_mesh

    # Two cells in a row, 10 and 30 px long and 10 px high, with 0 and 1 at their outer nodes.
    nodes = np.array([[0.0, 0.0], [10, 0], [40, 0], [0, 10], [10, 10], [40, 10]])
    mesh = build_mesh(nodes, {Q4: np.array([[0, 1, 4, 3], [1, 2, 5, 4]])})
    values = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 1.0])
    assert _average(mesh, values) == pytest.approx(0.5 * 30 / 40)
    values[[2, 5]] = np.nan
    assert _average(mesh, values) == 0.0
    assert np.isnan(_average(mesh, np.full(6, np.nan)))


def _number_anew(file: h5py.File) -> None:
    file["series"].attrs["numbers"] = np.nan


def _tell_twice(file: h5py.File) -> None:
    records = file["series/records"][...]
    del file["series/records"]
    file["series/records"] = np.concatenate([records, records[-1:]])


def _take_time(file: h5py.File) -> None:
    del file["frames/000001/time"].attrs["deformed"]


def _make_columns(file: h5py.File) -> None:
    old = file["VTKHDF/PointData/displacement"][...]
    del file["VTKHDF/PointData/displacement"]
    file["VTKHDF/PointData/displacement"] = np.stack([old, old], axis=-1)


@pytest.mark.parametrize(("damage", "read", "reason"), [
    (_number_anew, read_series, "whole numbers expected"),
    (_tell_twice, read_series, "a frame is told of twice"),
    (_take_time, lambda path: read_frame(path, 1), "no time"),
    (_make_columns, lambda path: find_displacement_range(read_series(path)),
     r"displacement: an array of float64, shape \(\d+, 3, 2\)"),
])
def test_a_damaged_series_is_refused(series: Path, damage: Callable[[h5py.File], None], read: Callable[[Path], object],
                                     reason: str) -> None:
    with h5py.File(series, "r+") as file:
        damage(file)
    with pytest.raises(InputError, match=reason):
        read(series)

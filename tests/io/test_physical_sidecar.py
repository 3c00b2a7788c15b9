"""A result in its length unit: what is warped in ParaView is the deformed specimen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import ddic
from ddic.errors import InputError
from ddic.io.result_reader import read_result
from ddic.io.result_schema import physical_path
from ddic.io.result_writer import move_result, remove_result

vtk = pytest.importorskip("vtk")
numpy_support = pytest.importorskip("vtk.util.numpy_support")

MM = 0.05
STRETCH = np.array([[0.02, 0.0], [0.0, -0.01]])


def measure(path: Path, **more: Any) -> ddic.Result:
    images = ddic.make_synthetic_pair(lambda points: (points - 80) @ STRETCH, (160, 160), seed=4)
    mesh = ddic.structured_mesh((20, 20, 140, 140), 20)
    sections: dict[str, Any] = {"solver": {"subdomains": 3}, "images": {"pixel_size": MM, "length_unit": "mm"}, **more}
    return ddic.measure(images, mesh, **sections | {"output": {"file": path, **more.get("output", {})}})


def warp(path: Path, vector: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points of all pieces before and after ParaView's Warp By Vector."""
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.Update()
    whole = reader.GetOutputDataObject(0)
    before, after = [], []
    for k in range(whole.GetNumberOfPartitions()):
        part = whole.GetPartition(k)
        part.GetPointData().SetActiveVectors(vector)
        filtered = vtk.vtkWarpVector()
        filtered.SetInputData(part)
        filtered.Update()
        before.append(numpy_support.vtk_to_numpy(part.GetPoints().GetData()))
        after.append(numpy_support.vtk_to_numpy(filtered.GetOutput().GetPoints().GetData()))
    return np.concatenate(before), np.concatenate(after)


def test_a_moved_or_removed_result_takes_it_along(tmp_path: Path) -> None:
    result, target = tmp_path / "r.vtkhdf", tmp_path / "moved.vtkhdf"
    measure(result)
    measure(target)
    before = warp(tmp_path / "r.physical.vtkhdf", "displacement")
    move_result(result, target)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"moved.vtkhdf", "moved.physical.vtkhdf", "moved.residual.vtkhdf"}
    after = warp(tmp_path / "moved.physical.vtkhdf", "displacement")
    np.testing.assert_array_equal(after, before)
    remove_result(target)
    assert not list(tmp_path.iterdir())


def test_one_of_what_has_no_length_unit_is_removed(tmp_path: Path) -> None:
    measure(tmp_path / "px.vtkhdf", images={})
    for name, rename in (("px.vtkhdf", "moved.vtkhdf"), ("text.vtkhdf", "words.vtkhdf")):
        (tmp_path / "text.vtkhdf").write_text("no result")
        physical_path(tmp_path / name).write_text("of an earlier one")
        move_result(tmp_path / name, tmp_path / rename)
        assert (tmp_path / rename).is_file()
        assert not list(tmp_path.glob("*.physical.vtkhdf"))


@pytest.mark.parametrize("flip_y", [False, True])
def test_warp_in_millimetres_is_the_deformed_specimen(tmp_path: Path, flip_y: bool) -> None:
    measure(tmp_path / "r.vtkhdf", output={"flip_y": flip_y})
    before, after = warp(tmp_path / "r.physical.vtkhdf", "displacement")
    pixels, moved = warp(tmp_path / "r.vtkhdf", "displacement")
    np.testing.assert_allclose(before, MM * pixels, rtol=1e-15)
    # VTK warps in single precision: half a unit in the last place of 140 px is 8e-6 px.
    np.testing.assert_allclose(after, MM * moved, rtol=0, atol=MM * 2e-5)
    width = np.ptp(after[:, 0]) / np.ptp(before[:, 0])
    # The measured stretch, whose error of 0.01 px over 120 px is 1e-4.
    assert width == pytest.approx(1.02, abs=3e-4)


def test_fields_and_cells_are_those_of_the_result(tmp_path: Path) -> None:
    measure(tmp_path / "r.vtkhdf")
    parts = {}
    for name in ("r", "r.physical"):
        reader = vtk.vtkHDFReader()
        reader.SetFileName(str(tmp_path / f"{name}.vtkhdf"))
        reader.Update()
        parts[name] = reader.GetOutputDataObject(0).GetPartition(1)
    one, other = parts["r"], parts["r.physical"]
    assert other.GetNumberOfCells() == one.GetNumberOfCells()
    names = {other.GetPointData().GetArrayName(k) for k in range(other.GetPointData().GetNumberOfArrays())}
    assert "nodal_von_mises_strain" in names
    # The only displacement is the one that fits the points.
    assert {name for name in names if name.startswith("displacement")} == {"displacement"}
    for name in ("strain_infinitesimal", "SubdomainId"):
        np.testing.assert_array_equal(numpy_support.vtk_to_numpy(other.GetCellData().GetArray(name)),
                                      numpy_support.vtk_to_numpy(one.GetCellData().GetArray(name)))


def test_it_is_no_result_and_goes_with_the_pixel_size(tmp_path: Path) -> None:
    measure(tmp_path / "r.vtkhdf")
    with pytest.raises(InputError, match=r"shows r\.vtkhdf in its length unit"):
        read_result(tmp_path / "r.physical.vtkhdf")
    measure(tmp_path / "r.vtkhdf", images={})
    assert not (tmp_path / "r.physical.vtkhdf").exists()

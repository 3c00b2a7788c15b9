"""A result and its company under another name, or gone."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest

from ddic.io.result_reader import read_result
from ddic.io.result_schema import earlier_path, not_converged_path, summary_path
from ddic.io.result_writer import move_result, remove_result

Write = Callable[..., Path]


@pytest.mark.parametrize("flip_y", [False, True])
def test_moved_result_is_read_as_before(tmp_path: Path, write_result: Write, flip_y: bool) -> None:
    path = write_result(tmp_path / "r.vtkhdf", flip_y=flip_y)
    before = read_result(path)
    with h5py.File(tmp_path / "r.residual.vtkhdf") as file:
        image, grid = file["VTKHDF/PointData/residual"][...], dict(file["VTKHDF"].attrs)
    summary_path(path).write_text('{"result_file": "r.vtkhdf", "iterations": 2}')
    target = tmp_path / "moved.vtkhdf"
    target.write_text("something older")
    (tmp_path / "moved.json").write_text("something older")
    move_result(path, target)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["moved.json", "moved.residual.vtkhdf", "moved.vtkhdf"]
    assert (read_result(target).displacement == before.displacement).all()
    with h5py.File(tmp_path / "moved.residual.vtkhdf") as file:
        assert file["VTKHDF/PointData/residual"][...].tobytes() == image.tobytes()
        assert all((file["VTKHDF"].attrs[name] == value).all() for name, value in grid.items() if name != "Type")
    assert json.loads((tmp_path / "moved.json").read_text()) == {"result_file": str(target), "iterations": 2}


def test_what_is_no_result_moves_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "r.vtkhdf").write_text("a text")
    (tmp_path / "r.json").write_text("no JSON {")
    move_result(tmp_path / "r.vtkhdf", tmp_path / "s.vtkhdf")
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"s.vtkhdf": "a text", "s.json": "no JSON {"}


def test_removed_result_leaves_nothing(tmp_path: Path, write_result: Write) -> None:
    path = write_result(tmp_path / "r.vtkhdf")
    summary_path(path).write_text("{}")
    (tmp_path / "other.json").write_text("{}")
    remove_result(path)
    remove_result(path)
    assert [p.name for p in tmp_path.iterdir()] == ["other.json"]


def test_names_differ_whatever_the_ending() -> None:
    for name in ("r.vtkhdf", "r.h5", "r", "r.1"):
        paths = [Path(name), not_converged_path(Path(name)), earlier_path(Path(name))]
        # Neither the results nor their summaries fall on one another.
        assert len({*paths, *(summary_path(path) for path in paths)}) == 6
    assert not_converged_path(Path("a/r.h5")) == Path("a/r.not_converged.h5")

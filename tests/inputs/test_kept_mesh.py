"""The mesh that the check has built is the one that is measured on."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import NoReturn

import pytest
from mpi4py import MPI

import ddic
from ddic.case.loader import load_case
from ddic.check.case import load_checked_case
from ddic.inputs import inputs as inputs_module
from ddic.inputs.inputs import open_inputs
from ddic.parallel.team import Team
from ddic.problem.reference_problem import build_whole_mesh
from support.cases import REGION, write_case, write_images


def _build_again(*_: object) -> NoReturn:
    raise AssertionError("the mesh was built once more")


@pytest.mark.parallel([1, 3])
def test_the_mesh_that_was_checked_is_not_built_again(shared_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    team = Team(MPI.COMM_WORLD)
    if team.is_root:
        write_images(shared_path)
        # One that rank 0 holds.
        write_case(shared_path, region=f'{REGION}\ncell = "T3"')
    team.wait_for_all()
    loaded = team.on_root(lambda: load_checked_case(shared_path / "case.toml", team.size))
    monkeypatch.setattr(inputs_module, "build_meshes", _build_again)
    inputs, _ = open_inputs(team, loaded)
    region = build_whole_mesh(team, inputs)
    assert (region is not None) == team.is_root


def test_a_mesh_is_taken_once_by_its_own_case(tmp_path: Path) -> None:
    path = write_case(tmp_path)
    loaded, other = load_case(path), load_case(path)
    mesh = ddic.structured_mesh((0, 0, 32, 32), 16)
    kept = loaded.kept_mesh
    assert kept.take(loaded.case) is None
    kept.keep(loaded.case, mesh, None)
    # As a case with other settings, which may ask for another mesh.
    assert kept.take(other.case) is None
    assert kept.take(loaded.case) == (mesh, None)
    assert kept.take(loaded.case) is None


def test_other_ranks_get_no_mesh(tmp_path: Path) -> None:
    path = write_case(tmp_path)
    loaded = load_case(path)
    loaded.kept_mesh.keep(loaded.case, ddic.structured_mesh((0, 0, 32, 32), 16), None)
    sent = pickle.loads(pickle.dumps(loaded))
    assert sent.kept_mesh.take(sent.case) is None

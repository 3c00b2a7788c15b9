"""The mesh that a check built goes to the measurement of the same case, once, and to nothing else."""

from __future__ import annotations

import pickle
from pathlib import Path

import ddic
from ddic.case.loader import load_case

CASE = """
[images]
reference = "f.tif"
deformed = "g.tif"
[mesh.structured]
region = [0, 0, 32, 32]
element_size = 16
"""


def test_a_mesh_is_taken_once_by_its_own_case(tmp_path: Path) -> None:
    path = tmp_path / "case.toml"
    path.write_text(CASE)
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
    path = tmp_path / "case.toml"
    path.write_text(CASE)
    loaded = load_case(path)
    loaded.kept_mesh.keep(loaded.case, ddic.structured_mesh((0, 0, 32, 32), 16), None)
    sent = pickle.loads(pickle.dumps(loaded))
    assert sent.kept_mesh.take(sent.case) is None

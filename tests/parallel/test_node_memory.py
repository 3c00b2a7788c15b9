"""Memory that a rank may still take."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from mpi4py import MPI

from ddic.parallel import node
from ddic.parallel.node import measure_available_memory, read_available_memory
from ddic.parallel.team import Team

LIMITED = """
import resource
from ddic.parallel.node import measure_available_memory
from ddic.parallel.team import Team
resource.setrlimit(resource.RLIMIT_AS, ({limit}, {limit}))
print(measure_available_memory(Team.alone()))
"""


@pytest.mark.parallel([1, 2, 3])
def test_ranks_of_a_node_share_its_memory() -> None:
    team = Team(MPI.COMM_WORLD)
    share = measure_available_memory(team)
    assert len(set(team.gather_lists([share]))) == 1
    # Others take and give back memory meanwhile: half of it is not likely to come and go.
    assert 0.5 < share * team.size / read_available_memory() < 2.0


def test_a_limit_of_the_process_counts() -> None:
    limit = 8 * 2**30
    done = subprocess.run([sys.executable, "-c", LIMITED.format(limit=limit)], capture_output=True, text=True,
                          check=True)
    assert 0 < int(done.stdout) < limit


def test_a_limit_of_the_control_group_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limit, current, kinds = (tmp_path / name for name in ("max", "current", "stat"))
    monkeypatch.setattr(node, "_GROUPS", (limit, current, kinds))
    without = read_available_memory()
    limit.write_text("3000000\n")
    current.write_text("2500000\n")
    kinds.write_text("anon 1500000\ninactive_file 400000\n")
    # 3.0 MB less 2.5 MB in use, of which 0.4 MB are given up when wanted.
    assert read_available_memory() == 900_000
    limit.write_text("max\n")
    assert read_available_memory() > 0.5 * without


def test_without_what_linux_tells_it_is_the_memory_of_the_machine(tmp_path: Path,
                                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    told = read_available_memory()
    monkeypatch.setattr(node, "_SYSTEM", tmp_path / "nothing")
    assert read_available_memory() >= told

"""Threads inside a rank: what a run does with the number, and what it says of it."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from ddic.case.loader import parse_case_text
from ddic.errors import InputError
from ddic.functionals import correlation
from ddic.images import spline
from ddic.images.threads import Threads
from ddic.io.result_schema import CELL_DATA, POINT_DATA, RESIDUAL_IMAGE
from ddic.methods.run import run_case
from ddic.parallel.team import Team
from ddic.problem import reference_problem, residual_model
from ddic.problem.reference_problem import list_own_cores, note_crowded_cores
from support.cases import Ears, case_text, contents, write_case, write_images

RANKS = [1, 3]


def _on_cores(monkeypatch: pytest.MonkeyPatch, cores: set[int]) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: cores, raising=False)


@pytest.mark.parallel(RANKS)
def test_note_compares_threads_of_a_node_with_its_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    team = Team.world()
    _on_cores(monkeypatch, set(range(2 * team.size)))
    fitting, crowded = note_crowded_cores(team, 2), note_crowded_cores(team, 3)
    # Ranks that are bound to a core each have as many cores as there are ranks.
    _on_cores(monkeypatch, {team.rank})
    single, bound = note_crowded_cores(team, 1), note_crowded_cores(team, 2)
    _on_cores(monkeypatch, {0})
    alone = note_crowded_cores(team, 1)
    assert fitting == single == alone == ()
    assert crowded == (f"threads: solver.threads = 3 x {team.size} MPI ranks of a node = {3 * team.size} threads, but "
                       f"these ranks may run on {2 * team.size} cores only: fewer threads are as fast",)
    assert f"may run on {team.size} cores" in bound[0]


def test_cores_are_counted_where_the_system_tells_no_affinity(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 6)
    assert len(list_own_cores()) == 6


# Not the assembled method, which is chosen for so few cells: MUMPS on two ranks rounds otherwise in any two runs.
MORE = """
[correlation]
grey_correction = "element"
[regularization]
cut_off_wavelength = 48.0
[solver]
method = "dual"
subdomains = 4
threads = {}
"""


def test_case_has_one_thread_unless_it_asks_for_more() -> None:
    assert parse_case_text(case_text(), Path("case.toml")).solver.threads == 1
    assert parse_case_text(case_text("[solver]\nthreads = 3"), Path("case.toml")).solver.threads == 3
    with pytest.raises(InputError, match=r"solver\.threads"):
        parse_case_text(case_text("[solver]\nthreads = 0"), Path("case.toml"))


@pytest.mark.parallel([1, 3])
def test_threads_of_the_case_reach_the_pixels_and_change_no_digit(shared_path: Path,
                                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    team = Team.world()
    made = []

    def threads(n: int) -> Threads:
        made.append(n)
        return Threads(n)

    for module in (reference_problem, residual_model):
        monkeypatch.setattr(module, "Threads", threads)
    # So that there is something to share out on 81 cells and 192 rows.
    monkeypatch.setattr(correlation, "FEWEST", 4)
    monkeypatch.setattr(spline, "_BAND_ROWS", 32)
    _on_cores(monkeypatch, {0})
    ears, files = [Ears(), Ears()], []
    for n, heard in zip((1, 3), ears, strict=True):
        files.append(shared_path / str(n) / "result.vtkhdf")
        if team.is_root:
            files[-1].parent.mkdir()
            write_images(files[-1].parent)
            write_case(files[-1].parent, MORE.format(n))
        team.wait_for_all()
        summary = run_case(team, files[-1].parent / "case.toml", heard)
        assert [*summary.notes, summary.stop] == heard.notes
    # Of the reference images and of the frame, once each.
    assert made == [1, 1, 3, 3]
    assert [sum("threads" in line for line in heard.notes) for heard in ears] == [0, 1]
    team.wait_for_all()
    one, three = (contents(file) for file in files)
    names = [name for name in one if name.startswith((POINT_DATA, CELL_DATA, RESIDUAL_IMAGE)) and "@" not in name]
    assert any(name.startswith(RESIDUAL_IMAGE) for name in names)
    for name in names:
        np.testing.assert_array_equal(one[name], three[name], err_msg=name)

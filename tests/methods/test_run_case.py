"""A whole run: checks, result and summary."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest
from mpi4py import MPI

from ddic.errors import ConvergenceError, InputError, is_collective
from ddic.methods.run import run_case
from ddic.parallel.phases import Phase
from ddic.parallel.team import Team
from support.cases import Ears, write_case, write_images

RANKS = [1, 3]
KEYS = {"converged", "iterations", "residual_std_grey", "n_dofs", "n_subdomains", "n_ranks", "krylov_iterations",
        "seconds", "peak_memory_bytes"}


def _write(folder: Path, more: str = "", **sections: str) -> Path:
    if MPI.COMM_WORLD.rank == 0:
        write_images(folder)
        write_case(folder, more, **sections)
    MPI.COMM_WORLD.barrier()
    return folder / "case.toml"


@pytest.mark.parallel(RANKS)
def test_result_and_summary_are_written(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    ears = Ears()
    path = _write(shared_path, '[solver]\nmethod = "dual"\nsubdomains = 4\n'
                               "[regularization]\ncut_off_wavelength = 48.0\n")
    summary = run_case(team, path, ears)
    assert set(ears.phases) == set(Phase)
    assert summary.converged
    assert summary.iterations == len(summary.krylov_iterations) == len(ears.records)
    assert summary.krylov_iterations[0] > 0
    assert 0 < summary.linear_error_px < 1e-4 / 20  # LAST_SHARE of the default tolerance
    assert (summary.n_dofs, summary.n_subdomains, summary.n_ranks) == (200, 4, team.size)
    assert len(summary.peak_memory_bytes) == team.size
    assert all(2**25 < n < 2**34 for n in summary.peak_memory_bytes)
    assert set(summary.seconds) == set(Phase)
    assert all(0 <= s < 60 for s in summary.seconds.values())
    assert set(summary.imbalance) == set(summary.seconds)
    assert all(1 <= ratio <= team.size * (1 + 1e-12) for ratio in summary.imbalance.values())
    assert 0 < summary.residual_std_grey < 2
    assert summary.n_pixels_outside == 0
    assert summary.cut_off_wavelength == 48.0
    # Every rank returns the same summary.
    texts = team.gather_lists([json.dumps(asdict(summary), sort_keys=True, default=list)])
    assert len(set(texts)) == 1
    team.comm.barrier()
    stored = json.loads((shared_path / "result.json").read_text())
    assert set(stored) >= KEYS
    assert stored["krylov_iterations"] == list(summary.krylov_iterations)
    assert stored["peak_memory_bytes"] == list(summary.peak_memory_bytes)
    assert stored["result_file"] == str(shared_path.resolve() / "result.vtkhdf")
    assert sorted(p.name for p in shared_path.iterdir()) == [
        "case.toml", "f.tif", "g.tif", "result.json", "result.residual.vtkhdf", "result.vtkhdf"]


@pytest.mark.parallel(RANKS)
def test_long_phases_say_how_far_they_are(shared_path: Path) -> None:
    team, ears = Team(MPI.COMM_WORLD), Ears()
    run_case(team, _write(shared_path, '[solver]\nmethod = "dual"\nsubdomains = 12\n'), ears)
    for phase in (Phase.ASSEMBLE, Phase.INDEPENDENT_START, Phase.FACTORIZE, Phase.INTERFACE_SET_UP):
        # A subdomain's worth at a time, of those that this rank owns.
        shares = [share for of_phase, share in ears.shares if of_phase == phase]
        n_own = round(1 / shares[0])
        assert shares[:n_own] == pytest.approx([k / n_own for k in range(1, n_own + 1)])


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("more", "sections", "line"), [
    ("[solver]\nsubdomain = 4\n", {}, "subdomains"),
    ("", {"deformed": "h.tif"}, "h.tif: no such image file"),
    ("", {"region": "region = [24, 24, 300, 168]"}, "case.toml|mesh"),
])
def test_bad_input_is_refused_on_all_ranks_before_anything_is_read(
        shared_path: Path, more: str, sections: dict[str, str], line: str) -> None:
    ears = Ears()
    with pytest.raises(InputError, match=line) as caught:
        run_case(Team(MPI.COMM_WORLD), _write(shared_path, more, **sections), ears)
    assert is_collective(caught.value)
    assert ears.phases == []


@pytest.mark.parallel(RANKS)
def test_without_convergence_nothing_has_the_name_of_the_result(shared_path: Path) -> None:
    path = _write(shared_path, "[solver]\nsubdomains = 4\n[gauss_newton]\nmax_iterations = 1\n[start]\n"
                               "rigid = false\npyramid = false\nindependent = false\n")
    if MPI.COMM_WORLD.rank == 0:
        (shared_path / "result.vtkhdf").write_text("an earlier result")
    with pytest.raises(ConvergenceError) as caught:
        run_case(Team(MPI.COMM_WORLD), path, Ears())
    assert is_collective(caught.value)
    MPI.COMM_WORLD.barrier()
    assert sorted(p.name for p in shared_path.iterdir()) == [
        "case.toml", "f.tif", "g.tif", "result.earlier.vtkhdf", "result.not_converged.json",
        "result.not_converged.residual.vtkhdf", "result.not_converged.vtkhdf"]
    assert (shared_path / "result.earlier.vtkhdf").read_text() == "an earlier result"


@pytest.mark.parallel([3])
@pytest.mark.parametrize(("solver", "line"), [
    ("subdomains = 1", r"solver\.subdomains: 1 subdomains for \d MPI ranks.*at most 1 ranks"),
    ('partition = "blocks"\nblocks = [1, 1]', r"solver\.blocks: 1 subdomains for \d MPI ranks"),
    ('method = "monolithic"', r"runs on one rank, \d were started"),
])
def test_more_ranks_than_subdomains(shared_path: Path, solver: str, line: str) -> None:
    with pytest.raises(InputError, match=line) as caught:
        run_case(Team(MPI.COMM_WORLD), _write(shared_path, f"[solver]\n{solver}\n"), Ears())
    assert is_collective(caught.value)


@pytest.mark.parallel(1)
@pytest.mark.parametrize("solver", ["", 'method = "monolithic"'])
def test_one_rank_needs_no_partition(shared_path: Path, solver: str) -> None:
    summary = run_case(Team(MPI.COMM_WORLD), _write(shared_path, f"[solver]\n{solver}\n"), Ears())
    assert summary.n_subdomains == 1
    assert list(summary.krylov_iterations) == [0] * summary.iterations
    assert summary.largest_jump_px == 0.0

"""A session that begins anew measures a frame as one that has seen no other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.case.loader import load_case
from ddic.inputs.cameras import open_frame, open_on_all_ranks
from ddic.inputs.inputs import open_inputs
from ddic.methods.dd_dic import DecomposedSession
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.synth.fields import Sinusoidal
from support.cases import write_case, write_images
from support.pictures import pair_of

SOLVERS = {
    "dual": '[solver]\nmethod = "dual"\nsubdomains = 4\n',
    "conjugate_gradient": '[solver]\nmethod = "conjugate_gradient"\nsubdomains = 4\n',
    "assembled": '[solver]\nmethod = "assembled"\nsubdomains = 4\n',
}
REGULARIZED = "[regularization]\ncut_off_wavelength = 48\n"


def measure(session: DecomposedSession, team: Team, path: Path) -> list[NDArray[np.float64]]:
    """Unknowns of the frame g.tif."""
    frame = open_frame(load_case(path).case, open_on_all_ranks(team, 2))
    return [np.array(q) for q in session.measure(frame).q]


def are_equal(one: list[NDArray[np.float64]], other: list[NDArray[np.float64]]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("more", ["", REGULARIZED], ids=["plain", "regularized"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_frame_comes_to_the_same_bits_after_another(shared_path: Path, solver: str, more: str) -> None:
    team = Team.world()
    case = shared_path / "case.toml"
    if team.is_root:
        write_images(shared_path)
        write_case(shared_path, SOLVERS[solver] + more)
        other = pair_of(Sinusoidal((1.3, 0.8), (0.6, 0.3), (200.0, 320.0), (320.0, 200.0)), 192, 8).deformed
        hidden = other.copy()
        # Operators of what is hidden are renewed.
        hidden[60:130, 70:140] = 20
        for name, image in (("clean", other), ("hidden", hidden)):
            folder = shared_path / name
            folder.mkdir()
            tifffile.imwrite(folder / "g.tif", image)
            (folder / "f.tif").write_bytes((shared_path / "f.tif").read_bytes())
            write_case(folder, SOLVERS[solver] + more)
    MPI.COMM_WORLD.barrier()
    inputs, _ = open_inputs(team, load_case(case))
    with DecomposedSession(team, inputs, Silence(), PhaseClock()) as session:
        expected = measure(session, team, case)
    again, after = [], []
    for name in ("clean", "hidden"):
        with DecomposedSession(team, inputs, Silence(), PhaseClock()) as session:
            measure(session, team, shared_path / name / "case.toml")
            session.begin_anew()
            again.append(measure(session, team, case))
            if solver == "dual":
                after.append(measure(session, team, case))
    n_other = [team.sum(sum(not np.array_equal(a, b) for a, b in zip(q, expected, strict=True))) for q in after]
    # Guards the test: directions that are kept leave other digits.
    assert all(n_other)
    for q in again:
        if solver == "assembled" and team.size > 1:
            # MUMPS adds up what ranks send it in the order in which it comes: rounding differs between any two runs.
            assert all(np.abs(a - b).max() <= 1e-10 for a, b in zip(q, expected, strict=True))
        else:
            assert are_equal(q, expected)

"""A known displacement is passed through the operators of the measurement: against one dense domain, on any ranks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from ddic.case.loader import load_case
from ddic.comparison.levelling import level
from ddic.inputs.inputs import open_inputs
from ddic.methods.dd_dic import DecomposedSession
from ddic.parallel.field import Field
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from support.cases import write_case, write_images

SOLVER = '[solver]\nmethod = "dual"\nsubdomains = 4\ntolerance = 1e-12\n'


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("pair") if MPI.COMM_WORLD.rank == 0 else None
    if path is not None:
        write_images(path)
        write_case(path, SOLVER).rename(path / "free.toml")
        write_case(path, f"[regularization]\ncut_off_wavelength = 64\n{SOLVER}")
    return MPI.COMM_WORLD.bcast(path)


def _bilinear(points: np.ndarray) -> np.ndarray:
    """A displacement that the elements hold."""
    x, y = points.T / 100.0
    return np.stack([0.3 + 0.2 * x - 0.1 * y, 0.1 * x * y], axis=1)


def _smooth(points: np.ndarray) -> np.ndarray:
    """One that they do not."""
    x, y = points.T / 30.0
    return np.stack([0.2 * np.sin(x) * np.cos(y), 0.1 * np.cos(x + y)], axis=1)


@pytest.mark.parallel([1, 2, 3])
def test_a_field_of_the_elements_stays_without_regularization(folder: Path) -> None:
    team = Team.world()
    inputs, frame = open_inputs(team, load_case(folder / "free.toml"))
    with DecomposedSession(team, inputs, Silence(), PhaseClock(), frame) as session:
        measured = session.measure(frame)
        levelled = level(measured.model, session.problem.solver.step, measured.q, _bilinear)
    for subdomain, q in zip(measured.subdomains, levelled.q, strict=True):
        # Krylov's tolerance on a field of 0.5 px.
        assert np.abs(q.reshape(-1, 2) - _bilinear(subdomain.mesh.nodes)).max() < 1e-8
    assert all((covered == 1.0).all() for covered in levelled.covered)


@pytest.mark.parallel([1, 2, 3])
def test_the_levelled_field_balances_the_equilibrium_gap(folder: Path) -> None:
    """A q = sum N^T grad f grad f^T u, of M's own pixels, which the measurement's linear step solves from rest, too."""
    team = Team.world()
    inputs, frame = open_inputs(team, load_case(folder / "case.toml"))
    with DecomposedSession(team, inputs, Silence(), PhaseClock(), frame) as session:
        measured = session.measure(frame)
        step = session.problem.solver.step
        found = level(measured.model, step, measured.q, _smooth).q
        # From another field: the problem is linear.
        again = level(measured.model, step, Field.zero(team, measured.subdomains), _smooth).q
        bilinear = level(measured.model, step, measured.q, _bilinear).q
        both = level(measured.model, step, measured.q, lambda points: 2.0 * _smooth(points) - _bilinear(points)).q
    assert (found - again).measure_rms() < 1e-8
    assert (both - (2.0 * found - bilinear)).measure_rms() < 1e-8
    # l_c of four elements takes from waves of 190 px, and from those along x + y.
    exact = found.with_parts(_smooth(subdomain.mesh.nodes).ravel() for subdomain in measured.subdomains)
    assert 0.005 < (found - exact).measure_rms() < 0.1


@pytest.mark.parallel([1, 2])
def test_where_nothing_is_known_the_measured_field_stays(folder: Path) -> None:
    team = Team.world()
    inputs, frame = open_inputs(team, load_case(folder / "free.toml"))

    def known(points: np.ndarray) -> np.ndarray:
        return np.where(points[:, :1] < 96.0, _bilinear(points), np.nan)

    with DecomposedSession(team, inputs, Silence(), PhaseClock(), frame) as session:
        measured = session.measure(frame)
        levelled = level(measured.model, session.problem.solver.step, measured.q, known)
    for subdomain, q, before, covered in zip(measured.subdomains, levelled.q, measured.q, levelled.covered,
                                             strict=True):
        x = subdomain.mesh.centroids[:, 0]
        assert (covered[x < 88.0] == 1.0).all()
        assert (covered[x > 104.0] == 0.0).all()
        far = subdomain.mesh.nodes[:, 0] > 165.0
        # What the left half says decays over some elements.
        difference = np.abs((q - before).reshape(-1, 2)[far])
        assert difference.max(initial=0.0) < 0.02

"""Systems weighted by the cameras' noise, set up once it is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ddic.case.loader import load_case
from ddic.images.sub_image import MaskedSource
from ddic.inputs.inputs import open_inputs
from ddic.parallel.field import Field
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.problem.residual_model import ResidualModel
from ddic.problem.weighted_problem import WeightedProblem
from support.cases import write_case, write_images
from support.near_far_cases import case_text as near_far_text
from support.near_far_cases import near_section, write_pairs
from support.prepared import prepare

RANKS = [1, 3]


def _one_camera(team: Team, folder: Path, more: str = "") -> Path:
    if team.is_root:
        write_images(folder)
        write_case(folder, f"[regularization]\ncut_off_wavelength = 48.0\nnot_controlled = []\n"
                           f'[solver]\nmethod = "dual"\nsubdomains = 4\n{more}')
    team.wait_for_all()
    return folder / "case.toml"


def _two_cameras(team: Team, folder: Path, far_noise: str, near_more: str) -> Path:
    path = folder / "case.toml"
    if team.is_root:
        write_pairs(folder)
        path.write_text(near_far_text(near_section(more=near_more), images=far_noise), encoding="utf-8")
    team.wait_for_all()
    return path


def model_of(problem: WeightedProblem, deformed: MaskedSource) -> ResidualModel:
    return problem.build_residual_model(problem.open_frame((deformed,)))


@pytest.mark.parallel(RANKS)
def test_one_camera_is_set_up_at_once(shared_path: Path) -> None:
    team = Team.world()
    gauss_newton = "[gauss_newton]\ntolerance = 2e-5\nrms_tolerance = 3e-6\nmax_iterations = 7\n"
    path = _one_camera(team, shared_path, gauss_newton)
    clock = PhaseClock()
    inputs, _ = open_inputs(team, load_case(path))
    problem = WeightedProblem(team, prepare(team, path), clock)
    try:
        assert problem.is_set_up
        # Operators are known for good when a frame has been looked at.
        q = [np.zeros(s.n_unknowns) for s in problem.reference.subdomains]
        assert problem.renew(model_of(problem, inputs.cameras[0].reference), q)[1] == ()
        assert problem.noise == ()
        assert problem.n_assembled == problem.solver.n_factorized == len(problem.reference.subdomains)
        assert {Phase.ASSEMBLE, Phase.FACTORIZE, Phase.INTERFACE_SET_UP} <= set(clock.wall)
        size = problem.size
        assert (size.n_unknowns, size.n_cells, size.n_subdomains, size.n_ranks) == (200, 81, 4, team.size)
        assert size.n_pixels == problem.reference.n_pixels
        assert size.eta == problem.solver.assembly.eta > 0
        assert size.n_interface == problem.solver.n_interface > 0
        tolerances = problem.tolerances
        assert (tolerances.relative, tolerances.rms, tolerances.max_iterations) == (2e-5, 3e-6, 7)
    finally:
        problem.destroy()
    assert not problem.is_set_up


@pytest.mark.parallel(RANKS)
def test_two_cameras_wait_for_their_noise(shared_path: Path) -> None:
    team = Team.world()
    reference = prepare(team, _two_cameras(team, shared_path, "noise = 3.0", ""))
    problem = WeightedProblem(team, reference, PhaseClock())
    try:
        assert not problem.is_set_up
        with pytest.raises(RuntimeError, match="noise of the cameras is not known"):
            _ = problem.solver
        problem.set_noise([3.0, 1.5])
        assert problem.is_set_up
        assert problem.noise == (3.0, 1.5)
        # Squared grey levels count in units of each camera's noise, the far field's for both.
        systems = problem.solver.assembly.systems
        for subdomain, (own, *_), (hessian, *_), system in zip(reference.subdomains, reference.views,
                                                               reference.hessians, systems, strict=True):
            weight = {0: 1.0, 1: 4.0}[subdomain.camera]
            expected = weight * own.project(hessian).toarray()
            np.testing.assert_allclose(system.hessian.toarray(), expected, rtol=1e-13)
    finally:
        problem.destroy()


@pytest.mark.parallel(RANKS)
def test_given_noise_sets_up_at_once(shared_path: Path) -> None:
    team = Team.world()
    path = _two_cameras(team, shared_path, "noise = 3.0", "noise = 1.5\nuse_far = true")
    _, frame = open_inputs(team, load_case(path))
    problem = WeightedProblem(team, prepare(team, path), PhaseClock())
    try:
        assert problem.is_set_up
        views = problem.open_frame(frame)
        assert {view.weight for view in views.flat} == {1.0}
        weighted = problem.build_residual_model(views).views
        for old, new in zip(views.flat, weighted.flat, strict=True):
            assert new.weight == {0: 1.0, 1: 4.0}[new.camera]
            assert new.deformed is old.deformed
            assert new.correlation is old.correlation
        cameras = team.gather_lists([tuple(v.camera for v in of_subdomain) for of_subdomain in weighted])
        # Its own camera first, then the far one, which measures near cells as well.
        assert set(cameras) == {(0,), (1, 0)}
    finally:
        problem.destroy()


@pytest.mark.parallel(RANKS)
def test_an_identical_frame_renews_nothing(shared_path: Path) -> None:
    team = Team.world()
    path = _one_camera(team, shared_path)
    inputs, _ = open_inputs(team, load_case(path))
    problem = WeightedProblem(team, prepare(team, path), PhaseClock())
    try:
        model = model_of(problem, inputs.cameras[0].reference)
        q = Field.zero(team, problem.reference.subdomains)
        step = problem.solver.step
        assert problem.renew(model, q)[1] == ()
        assert problem.solver.step is step
        # Everything 100 px to the right: of columns 24 to 168 those beyond 91 leave the image.
        away = q.map(lambda s, _: np.tile([100.0, 0.0], s.mesh.n_nodes))
        _, notes = problem.renew(model, away)
        assert "renewed" in notes[0]
        assert team.sum(problem.n_assembled) == team.sum(problem.solver.n_factorized) > 4
    finally:
        problem.destroy()

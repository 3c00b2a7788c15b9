"""A rigid motion of the region: found from unknowns on any ranks, and without cost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from ddic.mesh.rotation import Rotation
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.problem.added_forces import STEP_ANGLE, HeldRotation, RigidMotion, choose_stiffness_rotation, fit_rigid_motion
from support.cases import write_case, write_images
from support.prepared import assemble_alike, prepare

RANKS = [1, 3]
FREE = "[regularization]\ncut_off_wavelength = 48.0\nnot_controlled = []\n[solver]\nsubdomains = 4\n"


def _write(folder: Path) -> Path:
    if MPI.COMM_WORLD.rank == 0:
        write_images(folder)
        write_case(folder, FREE)
    MPI.COMM_WORLD.barrier()
    return folder / "case.toml"


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("angle", [-3.0, 0.001, 0.4, 3.1])
def test_a_rigid_motion_is_found(shared_path: Path, angle: float) -> None:
    team = Team.world()
    reference = prepare(team, _write(shared_path))
    motion = RigidMotion(Rotation(np.array([angle])), np.array([70.0, 90.0]), np.array([3.0, -2.0]))
    q = [motion.evaluate(s.mesh.nodes).ravel() for s in reference.subdomains]
    found = fit_rigid_motion(Field(team, reference.subdomains, q))
    np.testing.assert_allclose(found.rotation.angle, angle, atol=1e-12)
    points = np.array([[0.0, 0.0], [100.0, 30.0]])
    np.testing.assert_allclose(found.evaluate(points), motion.evaluate(points), atol=1e-10)


@pytest.mark.parallel(RANKS)
def test_forces_take_the_gap_of_the_rotation_away(shared_path: Path) -> None:
    team = Team.world()
    reference = prepare(team, _write(shared_path))
    systems = assemble_alike(team, reference).systems
    motion = RigidMotion(Rotation(np.array([0.3])), np.array([96.0, 96.0]), np.array([1.0, 2.0]))
    q = Field(team, reference.subdomains, [motion.evaluate(s.subdomain.mesh.nodes).ravel() for s in systems])
    forces = HeldRotation(team, systems).compute_forces(q)
    pieces = team.gather_lists([(s.subdomain.numbers, f) for s, f in zip(systems, forces, strict=True)])
    total = np.zeros(200)
    for numbers, values in pieces:
        np.add.at(total, numbers, values)
    # Alone, in one domain: eta Kbar^T Kbar q_R.
    if team.is_root:
        (shared_path / "one.toml").write_text((shared_path / "case.toml").read_text().replace(
            "subdomains = 4", "subdomains = 1"), encoding="utf-8")
    team.wait_for_all()
    alone = Team.alone()
    (system,) = assemble_alike(alone, prepare(alone, shared_path / "one.toml")).systems
    rest = motion.evaluate(system.subdomain.mesh.nodes).ravel()
    kbar = system.controlled_stiffness
    assert kbar is not None
    expected = system.eta * (kbar.T @ (kbar @ rest))
    np.testing.assert_allclose(total[system.subdomain.numbers], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    assert np.abs(expected).max() > 0


@pytest.mark.parametrize("steps", [(0.4,), (0.49, 0.49, 0.49), (1.3, -0.4, 0.2)])
def test_a_rotation_that_stays_is_turned_for_once(steps: tuple[float, ...]) -> None:
    # In space the corner of a cube of steps is farther from its middle than half a step.
    now, at_rest = Rotation(STEP_ANGLE * np.array(steps)), Rotation(np.zeros(len(steps)))
    chosen = choose_stiffness_rotation(now, at_rest)
    assert choose_stiffness_rotation(now, chosen) is chosen

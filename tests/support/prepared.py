"""What the reference images of a case give, without a frame."""

from __future__ import annotations

from pathlib import Path

from ddic.case.loader import load_case
from ddic.inputs.inputs import open_inputs
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.problem.assembly import Assembly, assemble
from ddic.problem.reference_problem import ReferenceProblem, build_whole_mesh, prepare_reference


def prepare(team: Team, path: Path) -> ReferenceProblem:
    """Cut the mesh, read the reference images and assemble M; collective."""
    inputs, _ = open_inputs(team, load_case(path))
    problem, _ = prepare_reference(team, inputs, build_whole_mesh(team, inputs), PhaseClock())
    return problem


def assemble_alike(team: Team, problem: ReferenceProblem) -> Assembly:
    """The local systems of cameras that all weigh 1; collective."""
    return assemble(team, problem, [1.0] * len(problem.inputs.cameras))

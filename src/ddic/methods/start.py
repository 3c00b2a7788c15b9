"""The displacement that Gauss-Newton starts from [BP17, Fig. 5]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.case.schema import Case
from ddic.errors import first_of
from ddic.io.result_reader import displacement_at, read_result
from ddic.mesh.mesh import Mesh
from ddic.methods.inputs import ImagePair
from ddic.parallel.team import Team
from ddic.solvers.gauss_newton import OwnedPart
from ddic.solvers.independent import independent_start
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.multilevel import MultilevelStart, multilevel_start


@dataclass(frozen=True)
class StartField:
    """Displacement of each owned subdomain (n_dofs,), pixels, and what the user should know about it."""

    q: list[NDArray[np.float64]]
    notes: tuple[str, ...]


def coarse_field(team: Team, case: Case, pair: ImagePair, mesh: Mesh | None,
                 nodes: Sequence[NDArray[np.float64]]) -> StartField:
    """Start from an earlier result, or from rigid correlation and the pyramid; rank 0 holds the mesh.

    nodes: of each owned subdomain, (n_nodes, 2) pixels.
    """
    if case.start.from_result is not None:
        return _from_result(team, case.start.from_result, nodes)

    def find() -> MultilevelStart:
        assert mesh is not None
        return multilevel_start(pair.reference, pair.deformed, mesh, rigid=case.start.rigid,
                                pyramid=case.start.pyramid, correction=case.correlation.grey_correction)

    start = team.on_root(find)
    notes = list(start.warnings)
    if start.rigid is not None:
        x, y = start.rigid.shift
        notes.insert(0, f"start: rigid shift ({x:.2f}, {y:.2f}) px, correlation coefficient "
                        f"{start.rigid.coefficient:.3f}")
    if start.levels:
        blocks = ", ".join(str(level) for level in start.levels)
        notes.append(f"start: pyramid on blocks of {blocks} px")
    return StartField([start.field.at(n).ravel() for n in nodes], tuple(notes))


def refine_independently(team: Team, case: Case, parts: Sequence[OwnedPart], systems: Sequence[LocalSystem],
                         coarse: StartField, smallest_eigenvalue: float) -> StartField:
    """Independent FE-DIC per subdomain, where the case asks for it."""
    if not case.start.independent:
        return coarse
    refined = team.together(lambda: independent_start(parts, systems, coarse.q, smallest_eigenvalue,
                                                      case.correlation.grey_correction))
    kept = team.gather_lists(refined.kept)
    note = "start: independent FE-DIC on every subdomain"
    if kept:
        note += f"; {len(kept)} kept the coarse field for want of texture or convergence ({first_of(kept)})"
    return StartField(refined.q, (*coarse.notes, note))


def _from_result(team: Team, path: Path, nodes: Sequence[NDArray[np.float64]]) -> StartField:
    wanted = team.comm.gather(list(nodes), root=0)

    def read() -> list[list[NDArray[np.float64]]]:
        assert wanted is not None
        result = read_result(path)
        return [[displacement_at(result, n).ravel() for n in rank] for rank in wanted]

    return StartField(team.scatter_from_root(read), (f"start: displacement of {path}",))

"""The displacement that Gauss-Newton starts from [BP17, Fig. 5]."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.case.schema import Case
from ddic.errors import first_of
from ddic.images.binned import bin_rows, binned_source
from ddic.images.grid_field import uniform_field
from ddic.io.result_reader import displacement_at, read_result
from ddic.mesh.mesh import Mesh
from ddic.parallel.team import Team
from ddic.problem.inputs import ImagePair
from ddic.solvers.gauss_newton import OwnedPart
from ddic.solvers.local_system import LocalSystem
from ddic.start.independent import independent_start
from ddic.start.multilevel import MultilevelStart, finest_block, multilevel_start
from ddic.start.pyramid_level import BinnedPair


@dataclass(frozen=True)
class StartField:
    """Displacement of each owned subdomain (n_dofs,), pixels, and what the user should know about it."""

    q: list[NDArray[np.float64]]
    notes: tuple[str, ...]


def coarse_task(team: Team, case: Case, pair: ImagePair, mesh: Mesh | None,
                ) -> Callable[[], MultilevelStart | None]:
    """What this rank has to do for rigid correlation and the pyramid, free of communication; collective.

    All ranks bin the images; the last one receives the blocks, and the mesh from rank 0, so that rank 0 may split the
    mesh at the same time. Elsewhere there is nothing to do, nor anywhere if the start is an earlier result, or zero.
    """
    if case.start.from_result is not None:
        return lambda: None
    if not (case.start.rigid or case.start.pyramid):
        zero = MultilevelStart(uniform_field((0.0, 0.0)), None, (), ())
        return lambda: zero
    last = team.size - 1
    blocks = _binned_together(team, pair)
    whole = team.hand_over(mesh, last)
    if blocks is None:
        return lambda: None
    assert whole is not None
    return partial(multilevel_start, blocks, whole, rigid=case.start.rigid, pyramid=case.start.pyramid,
                   correction=case.correlation.grey_correction)


def coarse_field(team: Team, case: Case, found: MultilevelStart | None,
                 nodes: Sequence[NDArray[np.float64]]) -> StartField:
    """Start from an earlier result, or from what the last rank found; collective.

    nodes: of each owned subdomain, (n_nodes, 2) pixels.
    """
    if case.start.from_result is not None:
        return _from_result(team, case.start.from_result, nodes)
    with team.waiting.counted():
        start: MultilevelStart = team.comm.bcast(found, root=team.size - 1)
    notes = list(start.warnings)
    if start.rigid is not None:
        x, y = start.rigid.shift
        notes.insert(0, f"start: rigid shift ({x:.2f}, {y:.2f}) px, correlation coefficient "
                        f"{start.rigid.coefficient:.3f}")
    if start.levels:
        blocks = ", ".join(str(level) for level in start.levels)
        notes.append(f"start: pyramid on blocks of {blocks} px")
    return StartField([start.field.at(n).ravel() for n in nodes], tuple(notes))


def _binned_together(team: Team, pair: ImagePair) -> BinnedPair | None:
    """Both images in the smallest blocks that the start looks at, on the last rank; each rank bins a band of rows."""
    image = pair.reference.image
    factor = finest_block(image.width * image.height)
    edges = np.linspace(0, image.height // factor, team.size + 1).astype(int)
    mine = range(int(edges[team.rank]), int(edges[team.rank + 1]))
    sources = (pair.reference, pair.deformed)
    own = team.together(lambda: [bin_rows(s, factor, mine) for s in sources])
    with team.waiting.counted():
        bands = team.comm.gather(own, root=team.size - 1)
    if bands is None:
        return None
    reference, deformed = (binned_source(s, [rank[k] for rank in bands]) for k, s in enumerate(sources))
    return BinnedPair(reference, deformed, factor)


def refine_independently(team: Team, case: Case, parts: Sequence[OwnedPart], systems: Sequence[LocalSystem],
                         coarse: StartField, smallest_eigenvalue: float) -> StartField:
    """Independent FE-DIC per subdomain, where the case asks for it and the dual method couples several."""
    alone = team.size == 1 and len(parts) == 1
    # Else the whole region's Gauss-Newton starts as cheaply: its factor is there, or none is needed.
    if alone or case.solver.method != "dual" or not case.start.independent:
        return coarse
    refined = team.together(lambda: independent_start(parts, systems, coarse.q, smallest_eigenvalue,
                                                      case.correlation.grey_correction))
    kept = team.gather_lists(refined.kept)
    note = "start: independent FE-DIC on every subdomain"
    if kept:
        note += f"; {len(kept)} kept the coarse field for want of texture or convergence ({first_of(kept)})"
    return StartField(refined.q, (*coarse.notes, note))


def _from_result(team: Team, path: Path, nodes: Sequence[NDArray[np.float64]]) -> StartField:
    with team.waiting.counted():
        wanted = team.comm.gather(list(nodes), root=0)

    def read() -> list[list[NDArray[np.float64]]]:
        assert wanted is not None
        result = read_result(path)
        return [[displacement_at(result, n).ravel() for n in rank] for rank in wanted]

    return StartField(team.scatter_from_root(read), (f"start: displacement of {path}",))

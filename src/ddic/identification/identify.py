"""Gauss-Newton for constitutive parameters, on any number of ranks: integrated DIC, and FEMU beside it.

FEMU fits the model to fields that were measured before, weighted by M: b' = M' (u_measured - u). Integrated DIC asks
the images themselves what is left, b' of grey-level conservation at the model's own displacement. Both take the same
steps; the first one costs no pass over pixels, and begins the second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy import sparse

from ddic.arrays import Array
from ddic.errors import ConvergenceError, as_collective
from ddic.identification.joint_step import FrameTerms, MaterialModel
from ddic.parallel.team import Team, require_held

MOST_ITERATIONS = 30
"""After which parameters are given up."""

SETTLED = 0.01
"""Correction of each parameter, in its standard deviations, from which on they are found."""

SETTLED_SHARE = 1e-6
"""The same relative to the parameters, where noise leaves less."""

MOST_HALVINGS = 20
"""Times that a correction is halved until there may be such a material."""


class FrameEvidence(Protocol):
    """What a frame says of a displacement of the whole mesh; every call is collective, arrays are rank 0's."""

    def gather_hessian(self) -> sparse.csr_matrix | None:
        """Give M, (n_dofs, n_dofs), grey levels squared per pixel squared; None on other ranks."""

    def gather_forces(self, u: Array | None) -> Array | None:
        """Give b at a displacement, both (n_dofs,), grey levels squared per pixel and pixels; None on other ranks."""

    def gather_measured(self) -> Array | None:
        """Give the displacement that was measured, (n_dofs,), pixels; None on other ranks."""


@dataclass(frozen=True, eq=False)
class FieldEvidence:
    """A measured field in the place of images; a ``FrameEvidence`` for rank 0 alone.

    Attributes
    ----------
    hessian : (n_dofs, n_dofs) csr_matrix or None
        M; None on other ranks.
    measured : (n_dofs,) array or None
        The field, pixels.
    """

    hessian: sparse.csr_matrix | None
    measured: Array | None

    def gather_hessian(self) -> sparse.csr_matrix | None:
        """Give M."""
        return self.hessian

    def gather_forces(self, u: Array | None) -> Array | None:
        """Give M (u_measured - u)."""
        if self.hessian is None or self.measured is None or u is None:
            return None
        return np.asarray(self.hessian @ (self.measured - u))

    def gather_measured(self) -> Array | None:
        """Give the field."""
        return self.measured


@dataclass(frozen=True, eq=False)
class Identified:
    """Parameters, the same on all ranks.

    Attributes
    ----------
    names : list of str
        Of the parameters.
    values : (n_parameters,) array
        Found.
    covariance : (n_parameters, n_parameters) array
        Of their errors, as far as noise of images and forces is the reason.
    u : list of (n_dofs,) array or None
        Displacement of all nodes in each frame, pixels, on rank 0; None elsewhere.
    n_iterations : int
        Of Gauss-Newton.
    """

    names: list[str]
    values: Array
    covariance: Array
    u: list[Array] | None
    n_iterations: int

    @property
    def deviations(self) -> Array:
        """Standard deviations, (n_parameters,)."""
        return np.asarray(np.sqrt(self.covariance.diagonal()))

    @property
    def correlations(self) -> Array:
        """Correlation coefficients, (n_parameters, n_parameters)."""
        return np.asarray(self.covariance / np.outer(self.deviations, self.deviations))


def identify(team: Team, model: MaterialModel | None, frames: Sequence[FrameEvidence], sigma: float,
             begin: Identified | None = None) -> Identified:
    """Find the parameters of a model from frames; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    model : MaterialModel or None
        What displacements there may be; rank 0's counts.
    frames : sequence of FrameEvidence
        What each frame says.
    sigma : float
        Standard deviation of the noise of both images, grey levels.
    begin : Identified, optional
        What was found before; by default the model's start and the measured fields.

    Returns
    -------
    Identified
        The parameters.

    Raises
    ------
    InputError, ConvergenceError
        On all ranks, where the frames do not tell the parameters apart, or they are not found.
    """
    hessians = _share_equal([frame.gather_hessian() for frame in frames])
    found = _begin(team, model, frames) if begin is None else replace(begin, n_iterations=0)
    for _ in range(MOST_ITERATIONS):
        found, is_settled = _iterate(team, model, frames, hessians, sigma, found)
        if is_settled:
            return found
    raise as_collective(ConvergenceError(f"identification: parameters are not found in {MOST_ITERATIONS} iterations"))


def correct_once(team: Team, model: MaterialModel | None, frames: Sequence[FrameEvidence], sigma: float,
                 begin: Identified) -> Identified:
    """Take one iteration from what was found otherwise, as ``identify`` does; collective."""
    return _iterate(team, model, frames, _share_equal([frame.gather_hessian() for frame in frames]), sigma, begin)[0]


def _begin(team: Team, model: MaterialModel | None, frames: Sequence[FrameEvidence]) -> Identified:
    """The model's start, and the measured fields."""
    measured = [frame.gather_measured() for frame in frames]
    names, values = team.on_root(lambda: (list(require_held(model).names), require_held(model).start))
    unknown = np.full((len(values),) * 2, np.nan)
    return Identified(names, values, unknown, [require_held(u) for u in measured] if team.is_root else None, 0)


def _iterate(team: Team, model: MaterialModel | None, frames: Sequence[FrameEvidence],
             hessians: Sequence[sparse.csr_matrix | None], sigma: float,
             before: Identified) -> tuple[Identified, bool]:
    """One iteration, and whether it was the last one."""
    fields: Sequence[Array | None] = [None] * len(frames) if before.u is None else before.u
    forces = [frame.gather_forces(u) for frame, u in zip(frames, fields, strict=True)]
    weight = 1.0 / (2.0 * sigma**2)

    def solve() -> tuple[Identified, bool]:
        scaled: dict[int, sparse.csr_matrix] = {id(of_frame): weight * require_held(of_frame) for of_frame in hessians}
        terms = [FrameTerms(require_held(u), scaled[id(hessian)], weight * require_held(b))
                 for u, hessian, b in zip(fields, hessians, forces, strict=True)]
        step = require_held(model).solve_step(before.values, terms)
        share = _find_possible_share(require_held(model), before.values, step.dp)
        values, covariance = before.values + share * step.dp, np.linalg.inv(step.information)
        small = np.maximum(SETTLED * np.sqrt(covariance.diagonal()), SETTLED_SHARE * np.abs(values))
        u = [of_frame.u + share * du for of_frame, du in zip(terms, step.du, strict=True)]
        return (Identified(before.names, values, covariance, u, before.n_iterations + 1),
                share == 1.0 and bool((np.abs(step.dp) <= small).all()))

    found = team.build_on_root(solve)
    known = None if found is None else (replace(found[0], u=None), found[1])
    of_all, is_settled = team.broadcast(known)
    return replace(of_all, u=None if found is None else found[0].u), is_settled


def _find_possible_share(model: MaterialModel, values: Array, dp: Array) -> float:
    """Largest share of a correction, by halves, with which there may be such a material."""
    for halvings in range(MOST_HALVINGS):
        share = 0.5**halvings
        if model.is_possible(values + share * dp):
            return share
    raise ConvergenceError("identification: the images ask for parameters that no material has; look at the law, and "
                           "at identification.loaded")


def _share_equal(hessians: list[sparse.csr_matrix | None]) -> list[sparse.csr_matrix | None]:
    """Put one matrix in the place of several that are the same: they are factorised once."""
    shared: list[sparse.csr_matrix | None] = []
    for hessian in hessians:
        before = shared[-1] if shared else None
        is_same = before is not None and hessian is not None and (before != hessian).nnz == 0
        shared.append(before if is_same else hessian)
    return shared

"""What the next frames of a series start from: fields of those before them, on the subdomains in use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddic.io.series_folder import FrameState
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.whole_field import place_at_nodes

Array = NDArray[np.float64]

N_STATES = 2
"""Frames from which the next one is extrapolated."""


@dataclass(frozen=True)
class MeasuredState:
    """What a frame starts from of an earlier one.

    Attributes
    ----------
    time : float
        Of the earlier frame, unit chosen by the user.
    q : list of (n_unknowns,) array
        Unknowns of owned subdomains since the first reference image.
    shown_share : float
        Share of the cells that were seen where the field put them.
    holds_back : bool
        Whether mechanics held cells back from where they were seen, so that the field shows no way to the next frame.
    """

    time: float
    q: list[Array]
    shown_share: float
    holds_back: bool

    def gather(self, team: Team, subdomains: Sequence[Subdomain], n_nodes: int) -> Array:
        """Gather the displacement of all nodes; collective.

        Parameters
        ----------
        team : Team
            All ranks.
        subdomains : sequence of Subdomain
            Owned ones, whose unknowns are displacements of nodes.
        n_nodes : int
            Of the whole mesh.

        Returns
        -------
        (n_nodes, 2) array
            Since the first reference image, pixels, on all ranks.
        """
        own = [(subdomain.node_ids, q.reshape(-1, 2)) for subdomain, q in zip(subdomains, self.q, strict=True)]
        return place_at_nodes(team.gather_lists(own), n_nodes)

    def restrict(self, displacement: Array, subdomains: Sequence[Subdomain]) -> MeasuredState:
        """Give the same state on other subdomains.

        Parameters
        ----------
        displacement : (n_nodes, 2) array
            Of ``gather``.
        subdomains : sequence of Subdomain
            Owned ones.

        Returns
        -------
        MeasuredState
            Of these.
        """
        return replace(self, q=[displacement[subdomain.node_ids].ravel() for subdomain in subdomains])


def collect_states(problem: WeightedProblem, states: Sequence[FrameState]) -> list[MeasuredState]:
    """Take up what an earlier run has measured; collective.

    Parameters
    ----------
    problem : WeightedProblem
        Whose cameras are weighted as they were.
    states : sequence of FrameState
        Of the last frames.

    Returns
    -------
    list of MeasuredState
        Of owned subdomains; none where the subdomains are others: the next frame is searched for then.
    """
    if states and states[-1].noise and not problem.is_set_up:
        problem.set_noise(states[-1].noise)
    subdomains = problem.reference.subdomains
    n_other = sum(len(state.unknowns.get(subdomain.index, ())) != subdomain.n_unknowns
                  for state in states for subdomain in subdomains)
    if problem.team.sum(n_other):
        return []
    return [MeasuredState(state.time, [state.unknowns[subdomain.index] for subdomain in subdomains], state.shown_share,
                          state.holds_back) for state in states]


def extrapolate(before: MeasuredState, last: MeasuredState, time: float) -> list[Array]:
    """Extrapolate the unknowns of two frames to a third; free of communication.

    Parameters
    ----------
    before, last : MeasuredState
        Of the same subdomains, in order of time.
    time : float
        Of the third.

    Returns
    -------
    list of (n_unknowns,) array
        Linear in time.
    """
    share = (time - last.time) / (last.time - before.time)
    return [q + share * (q - q_before) for q, q_before in zip(last.q, before.q, strict=True)]

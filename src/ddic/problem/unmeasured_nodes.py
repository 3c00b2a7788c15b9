"""Nodes of which a frame says nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.problem.held_unknowns import find_displaced_nodes, find_free_unknowns, find_held
from ddic.problem.residual_model import Evaluation
from ddic.problem.weighted_problem import WeightedProblem


def find_unmeasured_nodes(problem: WeightedProblem, evaluation: Evaluation) -> list[NDArray[np.bool_]]:
    """Find the nodes that neither pixels nor mechanics hold; collective.

    Parameters
    ----------
    problem : WeightedProblem
        Of the reference.
    evaluation : Evaluation
        Of a frame, with the pixels that count.

    Returns
    -------
    list of (n_nodes,) bool array
        Of each owned subdomain.
    """
    subdomains = problem.reference.subdomains
    if problem.reference.inputs.case.regularization is not None:
        return [np.zeros(subdomain.mesh.n_nodes, dtype=bool) for subdomain in subdomains]
    unseen = []
    for subdomain, of_views in zip(subdomains, evaluation.residuals, strict=True):
        counts = tuple(residual.cell_sums.n_pixels.astype(np.int64) for residual in of_views)
        unseen.append(~find_held(subdomain, counts))
    free = np.array(sorted(find_free_unknowns(problem.team, subdomains, unseen)), dtype=np.int64)
    return [find_displaced_nodes(subdomain, np.isin(subdomain.kinematics.numbers, free)) for subdomain in subdomains]


"""How large a PGD-DIC measurement is, and how its case says that it is to be made."""

from __future__ import annotations

import numpy as np

from ddic.case.schema import Case, PgdSection
from ddic.parallel.team import Team, require_held
from ddic.problem.inputs import Inputs
from ddic.problem.problem_size import ProblemSize, describe_cut_off
from ddic.separated.corrections import Regularization, Scheme, StoppingRules
from ddic.separated.pixel_bands import ReferencePixels, count_usable


def measure_separated_size(team: Team, inputs: Inputs, reference: ReferencePixels,
                           regularization: Regularization | None) -> ProblemSize:
    """Count what is about to be measured; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    inputs : Inputs
        What the measurement is made from.
    reference : ReferencePixels
        The reference image.
    regularization : Regularization or None
        With its weight.

    Returns
    -------
    ProblemSize
        Unknowns are those of the Q4 elements between the same lines.
    """
    rectangle = require_held(inputs.rectangle)
    n_x, n_y = rectangle.along_x.n_nodes, rectangle.along_y.n_nodes
    own = [(float(np.nanmin(band.values)), float(np.nanmax(band.values))) for band in reference.bands
           if np.isfinite(band.values).any()]
    ranges = team.gather_lists(own)
    dynamic_range = max(high for _, high in ranges) - min(low for low, _ in ranges)
    eta = 0.0 if regularization is None else regularization.weight
    return ProblemSize(2 * n_x * n_y, (n_x - 1) * (n_y - 1), int(team.sum(count_usable(reference.bands))), 1,
                       team.size, 0, dynamic_range, eta, describe_cut_off(inputs.case.regularization))


def choose_scheme(case: Case) -> Scheme:
    """Say how corrections are found.

    Parameters
    ----------
    case : Case
        With [pgd].

    Returns
    -------
    Scheme
        As the case asks for.
    """
    section = _get_section(case)
    return Scheme(section.max_sweeps, section.stagnation, section.update, case.correlation.correction_of_start)


def choose_rules(case: Case) -> StoppingRules:
    """Say when corrections end.

    Parameters
    ----------
    case : Case
        With [pgd].

    Returns
    -------
    StoppingRules
        As the case asks for.
    """
    section = _get_section(case)
    return StoppingRules(section.tolerance, section.rms_tolerance, section.max_corrections, section.stop_at_noise)


def _get_section(case: Case) -> PgdSection:
    if case.pgd is None:
        raise TypeError("a case without [pgd] is no PGD-DIC")
    return case.pgd

"""Fields for tests: of a model's subdomains, and of numbers that belong to no mesh."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import NDArray

from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.problem.residual_model import ResidualModel


def field_of(model: ResidualModel, parts: Sequence[NDArray]) -> Field:
    """The field of a model's subdomains."""
    return Field(model.team, model.subdomains, parts)


def plain_field(*parts: NDArray, team: Team | None = None) -> Field:
    """Numbers by subdomain, of which nothing but linear algebra is asked."""
    return Field(team or Team.alone(), (), parts)

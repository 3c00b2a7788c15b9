"""What a measurement tells while it runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from ddic.parallel.phases import Phase
from ddic.solvers.gauss_newton import IterationRecord


@dataclass(frozen=True)
class ProblemSize:
    """What is about to be solved.

    Attributes
    ----------
    n_unknowns : int
        Of the whole field.
    n_cells : int
        Cells of the mesh.
    n_pixels : int
        Pixels of the mesh that the reference images do not exclude.
    n_subdomains, n_ranks, n_interface : int
        Subdomains, MPI ranks, interface unknowns.
    dynamic_range : float
        max f - min f over the region, grey levels.
    eta : float
        Weight of the equilibrium gap, grey levels squared per pixel squared; 0 without.
    """

    n_unknowns: int
    n_cells: int
    n_pixels: int
    n_subdomains: int
    n_ranks: int
    n_interface: int
    dynamic_range: float
    eta: float


class Listener(Protocol):
    """Told on every rank; only rank 0's may speak."""

    def phase(self, phase: Phase) -> None:
        """Take note of a phase that begins."""
        ...

    def note(self, line: str) -> None:
        """Take note of something worth a line."""
        ...

    def problem_size(self, size: ProblemSize) -> None:
        """Take note of what is about to be solved."""
        ...

    def iteration(self, record: IterationRecord) -> None:
        """Take note of one Gauss-Newton iteration."""
        ...


class Silence:
    """Says nothing."""

    def phase(self, phase: Phase) -> None:
        """Ignore."""

    def note(self, line: str) -> None:
        """Ignore."""

    def problem_size(self, size: ProblemSize) -> None:
        """Ignore."""

    def iteration(self, record: IterationRecord) -> None:
        """Ignore."""

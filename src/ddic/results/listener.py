"""What a measurement tells while it runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from ddic.parallel.phases import Phase
from ddic.solvers.gauss_newton import IterationRecord


@dataclass(frozen=True)
class Setting:
    """What is about to be solved.

    n_dofs, n_cells, n_subdomains, n_ranks, n_interface: sizes; n_pixels: pixels of the mesh that the
    reference image does not exclude; dynamic_range: max f - min f over the region, grey levels;
    eta: weight of the equilibrium gap, 0 without.
    """

    n_dofs: int
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

    def setting(self, setting: Setting) -> None:
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

    def setting(self, setting: Setting) -> None:
        """Ignore."""

    def iteration(self, record: IterationRecord) -> None:
        """Ignore."""

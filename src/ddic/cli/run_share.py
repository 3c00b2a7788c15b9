"""How much of a run is done, as far as can be told while it goes on."""

from __future__ import annotations

from ddic.parallel.phases import REPEATED, Phase

WEIGHTS = {
    Phase.MESH: 3, Phase.START: 15, Phase.READ: 10, Phase.ASSEMBLE: 12, Phase.INDEPENDENT_START: 8,
    Phase.FACTORIZE: 12, Phase.INTERFACE_SET_UP: 10, Phase.RESIDUAL: 10, Phase.LINEAR_STEP: 10, Phase.FINISH: 3,
    Phase.WRITE: 7,
}
"""What each phase takes of a run, per cent, both of those that iterations repeat together: a guess from runs on 1 to
29 megapixels by the dual method. Where it is wrong, the time left is too, less and less as the run goes on."""

OF_ITERATION = 0.5
"""What one iteration of Gauss-Newton does of those that are left: it takes three to five as a rule."""

OF_CORRECTION = 0.1
"""The same of PGD-DIC's corrections, of which there are some ten or twenty."""


class RunShare:
    """Adds up what is done; it never goes back, although a run enters phases again.

    Attributes
    ----------
    done : float
        Share of the run, from 0 to 1.
    """

    def __init__(self) -> None:
        self.done = 0.0
        self._phase = Phase.MESH
        self._left_of_iterations = 1.0

    def begin(self, phase: Phase) -> None:
        """Take note of a phase that begins.

        Parameters
        ----------
        phase : Phase
            Of the run.
        """
        self._phase = phase
        if phase not in REPEATED:
            self.set_share(0.0)

    def set_share(self, share: float) -> None:
        """Take note of how far the phase at hand is.

        Parameters
        ----------
        share : float
            From 0 to 1.
        """
        if self._phase not in REPEATED:
            self._reach(_sum_before(self._phase) + share * WEIGHTS[self._phase])

    def add_iteration(self, share: float) -> None:
        """Take note of an iteration that has ended.

        Parameters
        ----------
        share : float
            What it did of those that were left.
        """
        self._left_of_iterations *= 1.0 - share
        weight = sum(WEIGHTS[phase] for phase in REPEATED)
        self._reach(_sum_before(REPEATED[0]) + weight * (1.0 - self._left_of_iterations))

    def _reach(self, per_cent: float) -> None:
        self.done = max(self.done, per_cent / sum(WEIGHTS.values()))


def _sum_before(phase: Phase) -> float:
    """What phases before one take, per cent."""
    phases = list(Phase)
    return float(sum(WEIGHTS[earlier] for earlier in phases[:phases.index(phase)]))

"""How much of a run is done."""

from __future__ import annotations

import pytest

from ddic.parallel.phases import Phase
from ddic.results.progress_bar import OF_ITERATION, WEIGHTS, RunShare


def test_all_phases_together_are_a_run() -> None:
    assert set(WEIGHTS) == set(Phase)
    assert sum(WEIGHTS.values()) == 100
    share = RunShare()
    for phase in Phase:
        share.begin(phase)
        share.set_share(1.0)
    assert share.done == pytest.approx(1.0)


def test_it_moves_inside_phases_and_with_iterations() -> None:
    share, seen = RunShare(), []
    share.begin(Phase.FACTORIZE)
    for n in range(5):
        share.set_share(n / 4)
        seen.append(share.done)
    # The factors take 12 per cent after the 48 of what is before them.
    assert seen == pytest.approx([0.48, 0.51, 0.54, 0.57, 0.60])
    share.begin(Phase.RESIDUAL)
    before = share.done
    share.add_iteration(OF_ITERATION)
    share.add_iteration(OF_ITERATION)
    # Three quarters of the 20 per cent that iterations take, after 70.
    assert share.done == pytest.approx(0.85)
    assert share.done > before


def test_it_never_goes_back() -> None:
    share = RunShare()
    share.begin(Phase.LINEAR_STEP)
    share.add_iteration(0.5)
    reached = share.done
    for phase in (Phase.READ, Phase.ASSEMBLE, Phase.FACTORIZE):
        share.begin(phase)
        share.set_share(0.5)
        assert share.done == reached

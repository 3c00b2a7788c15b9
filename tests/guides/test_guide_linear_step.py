from __future__ import annotations

import numpy as np
import pytest

from ddic.errors import ConvergenceError, is_collective
from support.guides import run_guide


def test_linear_step() -> None:
    guide = run_guide("linear-step")
    assert guide["difference"] < 1e-8
    result = guide["result"]
    assert 10 < result.krylov_iterations < guide["MAX_ITERATIONS"]
    assert result.krylov_history[-1] < 1e-8
    assert np.isnan(result.error)


def test_step_of_the_guide_raises_where_it_does_not_converge() -> None:
    guide = run_guide("linear-step")
    guide["MinresStep"].solve.__globals__["MAX_ITERATIONS"] = 2
    with pytest.raises(ConvergenceError, match="MINRES") as caught:
        guide["MinresStep"](guide["system"]).solve(guide["q"], guide["b"])
    assert is_collective(caught.value)

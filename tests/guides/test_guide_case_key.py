from __future__ import annotations

from support.guides import run_guide


def test_case_key() -> None:
    guide = run_guide("case-key")
    assert guide["section"].relaxation == 0.5
    assert guide["message"] == "Input should be less than or equal to 1"
    assert guide["RelaxedSolverSection"]().relaxation == 1.0
    assert guide["take_part"]([2.0, 4.0], guide["section"]) == [1.0, 2.0]

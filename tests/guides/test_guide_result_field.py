from __future__ import annotations

from support.guides import run_guide


def test_result_field() -> None:
    guide = run_guide("result-field")
    assert guide["area"].tolist() == 4 * [256.0] + 16 * [64.0]
    assert guide["unit"] == "px^2"

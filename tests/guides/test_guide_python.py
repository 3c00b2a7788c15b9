from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from support.guides import run_guide


def test_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    guide = run_guide("python")
    printed = capsys.readouterr().out
    # Two grey levels leave 0.02 px on elements of 10 px without regularization, a third of that with it.
    assert float(printed.split()[2]) < 0.01
    # Pure bending: strain xx is -4e-5 (y - 100).
    slope = np.polyfit(guide["result"].mesh.centroids[:, 1], guide["strain_xx"], 1)[0]
    assert slope == pytest.approx(-4e-5, rel=0.02)
    assert np.abs(guide["u_y"]).max() < 0.2
    assert np.array_equal(guide["read"].displacement, guide["frame_result"].displacement)
    assert matplotlib.image.imread(tmp_path / "beam.png").std() > 0.05

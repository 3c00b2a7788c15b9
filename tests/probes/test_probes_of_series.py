"""Probes and reports of a series: a row, or a page, for each frame."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from numpy.typing import NDArray

import ddic
from ddic.cli.info import report
from ddic.cli.tables import probe
from ddic.io.series_reader import read_frames
from support.commands import ddic as run_command

CASE = """
[images]
reference = "f.tif"
deformed = "g_*.tif"
[mesh.structured]
region = [16, 16, 144, 144]
element_size = 16
"""


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames, stretched by 2 and by 4 thousandths along y."""
    folder = tmp_path_factory.mktemp("series")
    for k in (1, 2):
        def stretch(points: NDArray[np.float64], strain: float = 0.002 * k) -> NDArray[np.float64]:
            return np.column_stack([np.zeros(len(points)), strain * (points[:, 1] - 80)])

        f, g = ddic.make_synthetic_pair(stretch, (160, 160), noise=1, seed=2)
        tifffile.imwrite(folder / "f.tif", f)
        tifffile.imwrite(folder / f"g_{k}.tif", g)
    (folder / "case.toml").write_text(CASE)
    ran = run_command("run", folder / "case.toml")
    assert ran.code == 0, ran.err
    return folder / "result.vtkhdf"


def test_a_row_for_each_frame(series: Path, tmp_path: Path) -> None:
    table = tmp_path / "out.csv"
    ran = CliRunner().invoke(probe, [str(series), "--extensometer", "80,30,80,130", "--csv", str(table)])
    assert ran.exit_code == 0, ran.output
    with table.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["time"] for row in rows] == ["1", "2"]
    strains = [float(row["strain_along [1]"]) for row in rows]
    noises = [float(row["noise_strain [1]"]) for row in rows]
    # Three standard deviations: noise of one grey level leaves about 0.0001 on 100 px.
    assert np.abs(np.subtract(strains, [0.002, 0.004])).max() < 3 * max(noises)
    assert max(noises) < 3e-4


def test_each_frame_knows_its_noise_floor(series: Path) -> None:
    floors = [frame.attributes["case"]["noise_floor_px"] for frame in read_frames(series)]
    assert len(floors) == 2
    assert all(0 < floor < 0.05 for floor in floors)  # pixels: noise of one grey level on gradients of tens


def test_a_page_of_a_frame(series: Path, tmp_path: Path) -> None:
    for arguments, number in (([], 2), (["--frame", "1"], 1)):
        page = tmp_path / "page.html"
        ran = CliRunner().invoke(report, [str(series), "--output", str(page), *arguments])
        assert ran.exit_code == 0, ran.output
        text = page.read_text(encoding="utf-8")
        assert f"0 (reference), {number} (deformed)" in text
        assert "this frame of the series" in text
    ran = CliRunner().invoke(report, [str(series), "--frame", "3"])
    assert ran.exit_code == 2
    assert "frame 3 is none of this series; choose one of 1 to 2" in ran.output

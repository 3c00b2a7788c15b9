from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from ddic.cli.info import info
from ddic.cli.plot import plot

Write = Callable[..., Path]


def test_info_of_an_image(tmp_path: Path) -> None:
    # A ramp of 3 along x and 4 along y: |grad f|^2 = 25 everywhere; one saturated pixel at its end.
    ramp = (3 * np.arange(100) + 4 * np.arange(50)[:, None]).astype(np.uint16)
    tifffile.imwrite(tmp_path / "ramp.tif", ramp)
    outcome = CliRunner().invoke(info, [str(tmp_path / "ramp.tif")])
    assert outcome.exit_code == 0
    assert "100 x 50 px" in outcome.output
    assert "uint16, 16 bit" in outcome.output
    assert "0 to 493 grey levels" in outcome.output
    assert "25 (grey level / px)^2" in outcome.output


def test_info_warns_of_colour_on_standard_error(tmp_path: Path) -> None:
    pixels = np.full((8, 10, 3), 255, np.uint8)
    pixels[0, 0] = (0, 0, 255)
    cv2.imwrite(str(tmp_path / "c.png"), pixels)
    outcome = CliRunner().invoke(info, [str(tmp_path / "c.png")])
    assert "warning" in outcome.stderr
    # Grey of full white is the integer type's largest value: counted as saturated.
    assert "98.750 % (at 255)" in outcome.stdout


def test_info_of_a_result(tmp_path: Path, write_result: Write) -> None:
    outcome = CliRunner().invoke(info, [str(write_result(tmp_path / "r.vtkhdf", flip_y=True))])
    assert outcome.exit_code == 0
    for text in ("20 nodes, 15 cells, 40 unknowns", "strain_green_lagrange", "2 iterations", "2, 1",
                 "provenance.n_ranks", "text of"):
        assert text in outcome.output
    assert outcome.output.splitlines()[3].split() == ["y", "axis", "in", "the", "file", "up"]


def test_info_counts_nodes_that_were_not_measured(tmp_path: Path, write_result: Write) -> None:
    whole, part = (CliRunner().invoke(info, [str(write_result(tmp_path / "r.vtkhdf", unmeasured=nodes))]).output
                   for nodes in ((), (6, 7)))
    # Inner nodes: the ranges are those of the others.
    ranges = [line for line in whole.splitlines() if line.startswith("displacement ")]
    assert len(ranges) == 2
    assert all(line in part.splitlines() for line in ranges)
    assert "not measured" not in whole
    assert "not measured                2 nodes, whose cells all are excluded" in part.splitlines()


@pytest.mark.parametrize("command", [info, plot])
def test_unreadable_files_end_with_one_line_and_exit_code_2(tmp_path: Path, command: object) -> None:
    (tmp_path / "bad.vtkhdf").write_text("nothing")
    outcome = CliRunner().invoke(command, [str(tmp_path / "bad.vtkhdf")])
    assert outcome.exit_code == 2
    assert "bad.vtkhdf" in outcome.stderr
    assert len(outcome.stderr.splitlines()) == 1


def test_plot_draws_all_that_the_file_allows(tmp_path: Path, write_result: Write) -> None:
    reference = tmp_path / "f.tif"
    tifffile.imwrite(reference, np.zeros((50, 60), np.uint8))
    path = write_result(tmp_path / "r.vtkhdf", reference=str(reference))
    outcome = CliRunner().invoke(plot, [str(path), "--output", str(tmp_path / "pictures")])
    assert outcome.exit_code == 0, outcome.output
    drawn = sorted(p.name for p in (tmp_path / "pictures").iterdir())
    assert drawn == [f"r.{kind}.png" for kind in ("deformed", "krylov", "partition", "residual")]
    for name in drawn:
        picture = cv2.imread(str(tmp_path / "pictures" / name))
        # 7 inches at 150 dpi, and more than an empty page.
        assert picture.shape[1] == 1050
        assert picture.std() > 5


def test_plot_of_two_results_adds_the_difference(tmp_path: Path, write_result: Write) -> None:
    one, two = write_result(tmp_path / "a.vtkhdf"), write_result(tmp_path / "b.vtkhdf", curves=False)
    outcome = CliRunner().invoke(plot, [str(one), "--other", str(two), "--component", "x"])
    assert outcome.exit_code == 0, outcome.output
    assert (tmp_path / "a.difference_x.png").exists()


@pytest.mark.parametrize(("kind", "remedy"), [("difference", "--other"), ("krylov", "another --kind"),
                                              ("near-far", "another --kind")])
def test_plot_says_what_a_figure_lacks(tmp_path: Path, write_result: Write, kind: str, remedy: str) -> None:
    path = write_result(tmp_path / "r.vtkhdf", curves=False)
    outcome = CliRunner().invoke(plot, [str(path), "--kind", kind])
    assert outcome.exit_code == 2
    assert remedy in outcome.stderr
    assert not list(tmp_path.glob("*.png"))


def test_info_describes_volumes_of_all_kinds_of_paths(tmp_path: Path) -> None:
    voxels = np.random.default_rng(5).integers(3, 900, (6, 7, 8), dtype=np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", voxels, photometric="minisblack")
    (tmp_path / "slices").mkdir()
    for number, plane in enumerate(voxels):
        tifffile.imwrite(tmp_path / "slices" / f"s{number}.tif", plane)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["entry/data"] = voxels
    for name in ("a.tif", "slices", "a.h5", "a.h5::entry/data"):
        outcome = CliRunner().invoke(info, [str(tmp_path / name)])
        assert outcome.exit_code == 0, outcome.output
        assert f"volume                      {tmp_path / name}\n" in outcome.output
        assert "8 x 7 x 6 px" in outcome.output
        assert f"{voxels.min()} to {voxels.max()} grey levels" in outcome.output

"""Inputs that change or vanish between their check and the end of reading are named, and nothing is written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from ddic.errors import InputError, is_collective
from ddic.methods.run import run_case, run_file
from ddic.parallel.phases import Phase
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from support.cases import case_text, write_case, write_images

SIDE = 96
REGION = "region = [16, 16, 80, 80]"


class Meddler(Silence):
    """Does something once, when a phase begins."""

    def __init__(self, phase: Phase, meddle: Callable[[], None]) -> None:
        self._phase, self._meddle = phase, meddle
        self._is_done = False

    def phase(self, phase: Phase) -> None:
        """Look for the phase."""
        if phase == self._phase and not self._is_done:
            self._is_done = True
            self._meddle()


def _replace(path: Path) -> None:
    """Give the image's name to one of the same size, as cameras do."""
    other = path.with_name("other.tif")
    tifffile.imwrite(other, np.zeros((SIDE, SIDE), np.uint8))
    other.replace(path)


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:1000])


@pytest.mark.parametrize("phase", [Phase.MESH, Phase.ASSEMBLE, Phase.RESIDUAL])
@pytest.mark.parametrize("name", ["f.tif", "g.tif", "mask.png"])
@pytest.mark.parametrize(("meddle", "what"), [
    (Path.unlink, "is no longer there"), (_replace, "was written to or replaced"),
    (_cut, "was written to or replaced")])
def test_a_pair_whose_inputs_change_is_no_result(tmp_path: Path, phase: Phase, name: str,
                                                 meddle: Callable[[Path], None], what: str) -> None:
    write_images(tmp_path, side=SIDE)
    tifffile.imwrite(tmp_path / "mask.tif", np.full((SIDE, SIDE), 255, np.uint8))
    (tmp_path / "mask.tif").rename(tmp_path / "mask.png")
    path = write_case(tmp_path, region=REGION, images='reference_mask = "mask.png"')
    (tmp_path / "result.vtkhdf").write_text("an earlier result")
    with pytest.raises(InputError) as caught:
        run_case(Team.alone(), path, Meddler(phase, lambda: meddle(tmp_path / name)))
    assert str(caught.value) == (f"{tmp_path / name}: {what} while it was in use; keep what a case names as it is "
                                 "during a run")
    assert is_collective(caught.value)
    assert (tmp_path / "result.vtkhdf").read_text() == "an earlier result"
    assert not list(tmp_path.glob(".*"))


def test_a_case_file_may_be_edited_while_it_is_run(tmp_path: Path) -> None:
    write_images(tmp_path, side=SIDE)
    path = write_case(tmp_path, region=REGION)
    run_case(Team.alone(), path, Meddler(Phase.ASSEMBLE, lambda: path.write_text("later", encoding="utf-8") and None))
    assert (tmp_path / "result.vtkhdf").is_file()


def test_a_frame_whose_image_changes_is_noted_and_the_others_are_measured(tmp_path: Path) -> None:
    write_images(tmp_path, side=SIDE)
    for number in (1, 2, 3):
        (tmp_path / f"g{number}.tif").write_bytes((tmp_path / "g.tif").read_bytes())
    text = case_text(region=REGION).replace('deformed = "g.tif"', 'deformed = ["g1.tif", "g2.tif", "g3.tif"]')
    path = tmp_path / "case.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(Exception, match=r"1 of 3 frames could not be measured: .*g2\.tif: was written to or replaced"):
        run_file(Team.alone(), path, Meddler(Phase.ASSEMBLE, lambda: _replace(tmp_path / "g2.tif")))

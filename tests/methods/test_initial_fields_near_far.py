"""Near and far images that start from a given displacement."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from ddic.methods.run import run_case
from ddic.parallel.team import Team
from support.cases import Ears
from support.measuring import measure
from support.near_far_cases import ALPHA, STRETCHED, case_text, near_section, write_pairs

SOLVER = "[solver]\nsubdomains = 5\ntolerance = 1e-12\n"


def _write(folder: Path, text: str, *, images: bool = False) -> Path:
    MPI.COMM_WORLD.barrier()
    path = folder / "case.toml"
    if MPI.COMM_WORLD.rank == 0:
        if images:
            write_pairs(folder)
        path.write_text(text, encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    return path


def _check(path: Path, ears: Ears) -> None:
    measured = measure(Team(MPI.COMM_WORLD), path, ears)
    (motion,) = measured.motions
    # As precise as from nothing: interpolation between grey levels.
    assert np.abs(motion.alpha - ALPHA).max() <= 3e-3
    for subdomain, u in zip(measured.subdomains, measured.displacements, strict=True):
        off = u.reshape(-1, 2) - STRETCHED.displacement(subdomain.mesh.nodes)
        assert np.sqrt((off**2).mean()) <= 8e-3


@pytest.mark.parallel([1, 3])
def test_pairs_of_the_far_image_are_moved_on_as_the_near_set_up_moved(shared_path: Path) -> None:
    points = np.array([[30.0, 30.0], [200.0, 40.0], [100.0, 170.0]])
    pairs = np.hstack([points, points + STRETCHED.displacement(points)]).round(2).tolist()
    ears = Ears()
    path = _write(shared_path, case_text(near_section(), more=f"{SOLVER}[start]\npoints = {pairs}\n"), images=True)
    _check(path, ears)
    told = [note for note in ears.notes if "start: " in note]
    # The far camera is within a pixel; the near one sees its own motion besides.
    of_cameras = [[note for note in told if note.startswith(label)] for label in ("far", "near")]
    assert len(of_cameras[0]) == 1
    assert any("moved on by" in note or "goes on from it" in note for note in of_cameras[1])


@pytest.mark.parallel([1, 3])
def test_a_result_on_a_part_is_extended_in_both_cameras(shared_path: Path) -> None:
    part = case_text(near_section(), more=SOLVER + '[output]\nfile = "result.vtkhdf"\n',
                     region="region = [40, 40, 200, 160]")
    run_case(Team(MPI.COMM_WORLD), _write(shared_path, part, images=True), Ears())
    ears = Ears()
    again = f'{SOLVER}[start]\nfrom_result = "result.vtkhdf"\nindependent = false\n'
    _check(_write(shared_path, case_text(near_section(), more=again)), ears)
    assert any("lie outside the mesh of" in note for note in ears.notes)
    # Everything is where it will stay: nothing is searched.
    assert not any("searching on" in note for note in ears.notes)
    assert ears.records[0].size.rms <= 0.05

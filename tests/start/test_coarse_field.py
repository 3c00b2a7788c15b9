"""The displacement that Gauss-Newton starts from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
from mpi4py import MPI

from ddic.case.loader import load_case
from ddic.images.sub_image import MaskedSource
from ddic.images.window import Window
from ddic.parallel.team import Team
from ddic.problem.inputs import ImagePair
from ddic.start.coarse_field import coarse_field, coarse_task
from ddic.start.multilevel import multilevel_start
from ddic.start.pyramid_level import BinnedPair
from support.cases import write_case, write_images
from support.pictures import source, square_mesh

RANKS = [1, 2, 3, 4]


@dataclass(frozen=True)
class _Unread:
    """An image that must not be read."""

    path: Path = Path("unread")
    width: int = 192
    height: int = 192
    saturation: float | None = None

    def read(self, window: Window) -> NoReturn:
        raise AssertionError(f"{window} was read")


@pytest.mark.parallel(RANKS)
def test_a_start_from_zero_reads_no_image(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    if team.is_root:
        write_images(shared_path)
        write_case(shared_path, "[start]\nrigid = false\npyramid = false\n")
    team.comm.barrier()
    case = load_case(shared_path / "case.toml").case
    mesh = square_mesh(24, 168)
    unread = MaskedSource(_Unread())
    found = coarse_task(team, case, ImagePair(unread, unread), mesh if team.is_root else None)()
    start = coarse_field(team, case, found, [mesh.nodes])
    np.testing.assert_array_equal(start.q[0], np.zeros(mesh.n_dofs))
    assert start.notes == ()


def test_zero_is_what_switching_everything_off_comes_to() -> None:
    image = source(np.zeros((192, 192), np.float32))
    mesh = square_mesh(24, 168)
    start = multilevel_start(BinnedPair(image, image, 1), mesh, rigid=False, pyramid=False, correction="none")
    np.testing.assert_array_equal(start.field.at(mesh.nodes), np.zeros_like(mesh.nodes))
    assert (start.rigid, start.levels, start.warnings) == (None, (), ())

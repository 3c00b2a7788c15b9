"""The displacement that Gauss-Newton starts from."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
from mpi4py import MPI

from ddic.case.loader import load_case
from ddic.case.schema import StartSection
from ddic.images.sub_image import MaskedSource
from ddic.images.window import Window
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs, open_inputs
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.problem.reference_problem import ReferenceProblem, build_whole_mesh, prepare_reference
from ddic.start.binned_pair import BinnedPair
from ddic.start.coarse_field import CoarseSearch, fit_found_fields, prepare_search
from ddic.start.helpers import Helpers
from ddic.start.multilevel import Pyramid, find_multilevel_start
from support.cases import WAVES, write_case, write_images
from support.pictures import rms_error, source, square_mesh

RANKS = [1, 3]


@dataclass(frozen=True)
class _Unread:
    """An image that must not be read."""

    path: Path = Path("unread")
    extent: Window = field(default_factory=lambda: Window((0, 0), (192, 192)))
    saturation: float | None = None

    def read(self, window: Window) -> NoReturn:
        raise AssertionError(f"{window} was read")


def _inputs(folder: Path, team: Team, more: str) -> tuple[Inputs, Frame]:
    if team.is_root:
        write_images(folder)
        write_case(folder, more)
    team.wait_for_all()
    return open_inputs(team, load_case(folder / "case.toml"))


def _prepare(team: Team, inputs: Inputs) -> tuple[CoarseSearch, ReferenceProblem]:
    region_mesh = build_whole_mesh(team, inputs)
    problem, _ = prepare_reference(team, inputs, region_mesh, PhaseClock())
    return prepare_search(team, inputs, None if region_mesh is None else region_mesh.measured), problem


@pytest.mark.parallel(RANKS)
def test_a_start_from_zero_reads_no_image(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    inputs, _ = _inputs(shared_path, team, "[start]\nrigid = false\npyramid = false\n")
    search, problem = _prepare(team, inputs)
    unread = MaskedSource(_Unread())
    blind = replace(search, cameras=tuple(replace(camera, reference=unread) for camera in search.cameras))
    _, found = blind.find((unread,), lambda: None)
    assert found is not None
    start, notes = fit_found_fields(search, problem, found)
    for subdomain, q in zip(problem.subdomains, start, strict=True):
        np.testing.assert_array_equal(q, np.zeros(subdomain.n_field))
    assert notes == ()


@pytest.mark.parallel(RANKS)
def test_a_frame_that_is_not_known_is_not_searched(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    inputs, _ = _inputs(shared_path, team, "")
    search, _ = _prepare(team, inputs)
    assert search.find(None, lambda: 7) == (7, None)


@pytest.mark.parallel(RANKS)
def test_subdomains_start_from_the_coarse_field_of_the_whole(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    inputs, frame = _inputs(shared_path, team, "[solver]\nsubdomains = 4\n")
    search, problem = _prepare(team, inputs)
    _, found = search.find(frame, lambda: None)
    assert found is not None
    start, notes = fit_found_fields(search, problem, found)
    for subdomain, q in zip(problem.subdomains, start, strict=True):
        np.testing.assert_array_equal(q.reshape(-1, 2), found[0].field.at(subdomain.mesh.nodes))
        # The pyramid's cells of 16 blocks follow these waves to a tenth of a pixel or so.
        assert rms_error(q, subdomain.mesh.nodes, WAVES) <= 0.2
    assert [word in note for word, note in zip(("rigid shift", "pyramid"), notes, strict=True)] == [True, True]


@pytest.mark.parallel(RANKS)
def test_the_images_are_read_before_ranks_turn_to_work_of_their_own(shared_path: Path,
                                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    # Else the last rank would wait for rank 0, which splits the mesh, before it begins.
    team, read = Team(MPI.COMM_WORLD), list[int]()
    inputs, frame = _inputs(shared_path, team, "")
    search, _ = _prepare(team, inputs)
    read_whole = Helpers.read_whole
    monkeypatch.setattr(Helpers, "read_whole", lambda self, size: read.append(size) or read_whole(self, size))
    n_read, _ = search.find(frame, lambda: len(read))
    is_last = team.rank == team.size - 1
    assert (n_read, len(read)) == ((1, 1) if is_last else (0, 0))


def test_zero_is_what_switching_everything_off_comes_to() -> None:
    image = source(np.zeros((192, 192), np.float32))
    mesh = square_mesh(24, 168)
    start = find_multilevel_start(Pyramid(BinnedPair(image, image, 1), mesh, "none"),
                                  StartSection(rigid=False, pyramid=False))
    np.testing.assert_array_equal(start.field.at(mesh.nodes), np.zeros_like(mesh.nodes))
    assert (start.rigid, start.levels, start.warnings) == ((), (), ())

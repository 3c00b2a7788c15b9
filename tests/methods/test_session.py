"""A session: prepared once from the reference images, then any number of frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from ddic.case.loader import load_case
from ddic.errors import ConvergenceError, is_collective
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs, open_inputs
from ddic.methods.dd_dic import DecomposedSession
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.synth.fields import Affine, DisplacementField, Sinusoidal
from support.cases import Ears, write_case
from support.measuring import measure, whole_field
from support.near_far_cases import PLAIN, NearField, near_section, write_pairs
from support.near_far_cases import case_text as near_far_text
from support.petsc_objects import count_live_objects
from support.pictures import pair_of

RANKS = [1, 3]
SIDE = 192
FIELDS: tuple[DisplacementField, ...] = (
    Sinusoidal((0.3, -0.2), (0.5, 0.4), (256.0, 320.0), (320.0, 256.0)),
    Sinusoidal((2.3, -1.2), (0.4, 0.5), (256.0, 320.0), (320.0, 256.0)),
    Affine(((0.004, 0.002), (-0.003, -0.005)), (0.2, 0.1), (96.0, 96.0)),
)
TIGHT = "[gauss_newton]\ntolerance = 1e-10\nrms_tolerance = 0.0\nmax_iterations = 200\n"
REGULARIZED = "[regularization]\ncut_off_wavelength = 64.0\n"
BLOCKS = '[solver]\npartition = "blocks"\nblocks = [3, 3]\ntolerance = 1e-12\n'
"""Nine subdomains of 3 x 3 cells, 48 px wide from column and row 24 on."""

SAME_PX = 1e-6
"""Gauss-Newton to 1e-10 and Krylov to 1e-12: whatever M it goes by, what is left is far below."""


def write_frames(team: Team, folder: Path, more: str, masks: dict[int, NDArray[np.bool_]] | None = None) -> None:
    """f.tif, and for each field a deformed image, a mask where one is given, and a case n.toml."""
    if team.is_root:
        for number, field in enumerate(FIELDS):
            pair = pair_of(field, SIDE, 8)
            tifffile.imwrite(folder / "f.tif", pair.reference)
            tifffile.imwrite(folder / f"g{number}.tif", pair.deformed)
            images = ""
            if masks and number in masks:
                tifffile.imwrite(folder / f"mask{number}.tif", masks[number].astype(np.uint8))
                images = f'deformed_mask = "mask{number}.tif"'
            write_case(folder, more, deformed=f"g{number}.tif", images=images).rename(folder / f"{number}.toml")
    team.wait_for_all()


def shows_all_but(columns: tuple[int, int], rows: tuple[int, int]) -> NDArray[np.bool_]:
    """A mask that hides a rectangle."""
    mask = np.ones((SIDE, SIDE), dtype=bool)
    mask[rows[0]:rows[1], columns[0]:columns[1]] = False
    return mask


def open_frames(team: Team, folder: Path, numbers: range = range(len(FIELDS))) -> tuple[Inputs, list[Frame]]:
    opened = [open_inputs(team, load_case(folder / f"{number}.toml")) for number in numbers]
    return opened[0][0], [frame for _, frame in opened]


def session_of(team: Team, inputs: Inputs, ears: Ears | None = None) -> DecomposedSession:
    return DecomposedSession(team, inputs, ears or Ears(), PhaseClock())


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("method", "regularization"), [
    ("dual", REGULARIZED), ("dual", ""), ("assembled", REGULARIZED), ("conjugate_gradient", REGULARIZED)])
def test_frames_equal_separate_runs(shared_path: Path, method: str, regularization: str) -> None:
    team = Team.world()
    write_frames(team, shared_path, f'{BLOCKS}method = "{method}"\n{TIGHT}{regularization}')
    inputs, frames = open_frames(team, shared_path)
    with session_of(team, inputs) as session:
        found = [whole_field(session.measure(frame)) for frame in frames]
        n_own = len(session.problem.reference.subdomains)
        # Once, from the reference images.
        assert session.problem.n_assembled == session.problem.solver.n_factorized == n_own
    for number, field in enumerate(found):
        separate = whole_field(measure(team, shared_path / f"{number}.toml"))
        assert np.abs(field - separate).max() <= SAME_PX


@pytest.mark.parallel([1])
def test_one_domain_measures_frames_as_well(shared_path: Path) -> None:
    team = Team.world()
    write_frames(team, shared_path, f'[solver]\nmethod = "monolithic"\n{TIGHT}{REGULARIZED}')
    inputs, frames = open_frames(team, shared_path)
    with session_of(team, inputs) as session:
        found = [whole_field(session.measure(frame)) for frame in frames]
        assert session.problem.n_assembled == session.problem.solver.n_factorized == 1
    for number, field in enumerate(found):
        separate = whole_field(measure(team, shared_path / f"{number}.toml"))
        assert np.abs(field - separate).max() <= SAME_PX


@pytest.mark.parallel([1, 3])
def test_a_frame_can_start_from_an_earlier_one(shared_path: Path) -> None:
    team = Team.world()
    write_frames(team, shared_path, BLOCKS + TIGHT + REGULARIZED)
    inputs, frames = open_frames(team, shared_path)
    ears = Ears()
    with session_of(team, inputs, ears) as session:
        first = session.measure(frames[0])
        second = session.measure(frames[1], start=first.q)
        again = session.measure(frames[1], start=second.q)
    assert second.notes[-1] == again.notes[-1] == "start: an earlier frame"
    assert np.abs(whole_field(second) - whole_field(measure(team, shared_path / "1.toml"))).max() <= SAME_PX
    # It is where it ends, to the tolerance that it ended by.
    assert len(again.records) == 1


@pytest.mark.parallel([1, 3])
def test_the_frame_that_is_known_beforehand_is_not_searched_twice(shared_path: Path) -> None:
    team = Team.world()
    write_frames(team, shared_path, BLOCKS + TIGHT + REGULARIZED)
    inputs, frames = open_frames(team, shared_path)
    notes = []
    for first_frame in (frames[0], None):
        with DecomposedSession(team, inputs, Ears(), PhaseClock(), first_frame) as session:
            notes.append([session.measure(frame).notes for frame in frames[:2]])
    # Every frame has a start of its own, whenever it was sought.
    assert notes[0] == notes[1]
    assert all(sum("rigid shift" in note for note in of_frame) == 1 for of_frame in notes[0])
    assert notes[0][0] != notes[0][1]


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("method", ["dual", "assembled"])
def test_only_subdomains_that_lose_pixels_are_renewed(shared_path: Path, method: str) -> None:
    team = Team.world()
    # The middle of block 5 and a share of block 8, columns 120 to 168; and a pixel or two of block 0.
    mask = shows_all_but((140, 165), (80, 130))
    mask[30, 30:32] = False
    write_frames(team, shared_path, f'{BLOCKS}method = "{method}"\n{TIGHT}{REGULARIZED}', {1: mask})
    inputs, frames = open_frames(team, shared_path)
    ears = Ears()
    with session_of(team, inputs, ears) as session:
        own = [s.index for s in session.problem.reference.subdomains]
        found, counts = [], []
        for frame in frames:
            found.append(whole_field(session.measure(frame)))
            counts.append((session.problem.n_assembled, session.problem.solver.n_factorized))
    n_own, n_renewed = len(own), len(set(own) & {5, 8})
    # They lose pixels in the second frame and have them back in the third.
    assert counts == [(n_own + k * n_renewed, n_own + k * n_renewed) for k in range(3)]
    renewed = [note for note in ears.notes if "renewed" in note]
    assert [note.split(" lost")[0] for note in renewed] == ["2 subdomains (5, 8)"] * 2
    for number, field in enumerate(found):
        separate = whole_field(measure(team, shared_path / f"{number}.toml"))
        assert np.abs(field - separate).max() <= SAME_PX


@pytest.mark.parallel([1, 3])
def test_as_many_other_pixels_renew_as_well(shared_path: Path) -> None:
    # The left half of block 4 in the first frame, its right half in the second: M that lacks the half that is
    # shown would overshoot there a hundred times.
    team = Team.world()
    masks = {0: shows_all_but((72, 96), (60, 130)), 1: shows_all_but((98, 122), (60, 130))}
    write_frames(team, shared_path, BLOCKS + TIGHT + REGULARIZED, masks)
    inputs, frames = open_frames(team, shared_path)
    with session_of(team, inputs) as session:
        first = session.measure(frames[0])
        found = session.measure(frames[1], start=first.q)
    separate = measure(team, shared_path / "1.toml")
    assert any("renewed" in note for note in found.notes)
    assert np.abs(whole_field(found) - whole_field(separate)).max() <= SAME_PX


@pytest.mark.parallel(RANKS)
def test_a_frame_that_cannot_be_measured_leaves_the_session_whole(shared_path: Path) -> None:
    team = Team.world()
    # With free edges, mechanics would hold all of it.
    more = BLOCKS + TIGHT + REGULARIZED + "not_controlled = []\n"
    write_frames(team, shared_path, more, {1: shows_all_but((0, SIDE), (0, SIDE))})
    inputs, frames = open_frames(team, shared_path)
    with session_of(team, inputs) as session:
        before = whole_field(session.measure(frames[0]))
        with pytest.raises(ConvergenceError, match="no pixel is left") as caught:
            session.measure(frames[1])
        assert is_collective(caught.value)
        after, third = (whole_field(session.measure(frames[k])) for k in (0, 2))
    assert np.abs(after - before).max() <= SAME_PX
    assert np.abs(third - whole_field(measure(team, shared_path / "2.toml"))).max() <= SAME_PX


@pytest.mark.parallel(RANKS)
def test_a_subdomain_that_is_hidden_altogether_is_not_measured_and_comes_back(shared_path: Path) -> None:
    team = Team.world()
    # Without regularization nothing holds the nodes of hidden cells: those of block 4, moved by (2, -1) px.
    write_frames(team, shared_path, BLOCKS + TIGHT, {1: shows_all_but((71, 124), (69, 121))})
    inputs, frames = open_frames(team, shared_path)
    with session_of(team, inputs) as session:
        hidden = whole_field(session.measure(frames[1]))
        found = [whole_field(session.measure(frames[k])) for k in (0, 2)]
    # 4 x 4 nodes of 3 x 3 cells: at (72, 72) to (120, 120).
    nodes = np.stack(np.meshgrid(*2 * (np.arange(24.0, 169.0, 16.0),)), axis=-1).reshape(-1, 2)
    is_inside = ((nodes > 72 - 8) & (nodes < 120 + 8)).all(axis=1)
    assert np.isnan(hidden[is_inside & ((nodes > 72) & (nodes < 120)).all(axis=1)]).all()
    assert np.isfinite(hidden[~is_inside]).all()
    for number, field in zip((0, 2), found, strict=True):
        assert np.abs(field - whole_field(measure(team, shared_path / f"{number}.toml"))).max() <= SAME_PX


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("method", ["dual", "assembled", "conjugate_gradient"])
def test_nothing_of_petsc_is_left_by_frames(shared_path: Path, method: str) -> None:
    team = Team.world()
    mask = shows_all_but((140, 165), (80, 130))
    write_frames(team, shared_path, f'{BLOCKS}method = "{method}"\n{REGULARIZED}', {1: mask})
    inputs, frames = open_frames(team, shared_path)
    count_live_objects(team, shared_path)
    before = count_live_objects(team, shared_path)
    with session_of(team, inputs) as session:
        counts = []
        for number in range(12):
            session.measure(frames[number % 3])
            if number % 3 == 2:
                counts.append(count_live_objects(team, shared_path))
    assert counts[1:] == counts[:-1]
    assert count_live_objects(team, shared_path) == before


@pytest.mark.parallel([1, 3])
def test_two_cameras_measure_frames(shared_path: Path) -> None:
    team = Team.world()
    moved = NearField(motion=PLAIN.motion)
    strains = [Affine(((0.004 * k, 0.003), (-0.002, 0.006 * k)), (0.4 * k, -0.3), (120.0, 100.0)) for k in (1, 2)]
    solver = "[solver]\nsubdomains = 5\ntolerance = 1e-12\n"
    text = near_far_text(near_section(moved, "noise = 0.5"), images="noise = 0.5", more=solver + TIGHT)
    opened = []
    for number, field in enumerate(strains):
        folder = shared_path / str(number)
        if team.is_root:
            write_pairs(folder, moved, field)
            (folder / "case.toml").write_text(text, encoding="utf-8")
        team.wait_for_all()
        opened.append(open_inputs(team, load_case(folder / "case.toml")))
    with session_of(team, opened[0][0]) as session:
        found = [session.measure(frame) for _, frame in opened]
        n_views = len(session.problem.reference.subdomains)
        assert session.problem.n_assembled == session.problem.solver.n_factorized == n_views
    for number, measured in enumerate(found):
        separate = measure(team, shared_path / str(number) / "case.toml")
        assert np.abs(whole_field(measured) - whole_field(separate)).max() <= SAME_PX
        np.testing.assert_allclose(measured.motions[0].alpha, separate.motions[0].alpha, rtol=0, atol=SAME_PX)


@pytest.mark.parallel([1, 3])
def test_the_first_frame_tells_the_noise_of_two_cameras(shared_path: Path) -> None:
    team = Team.world()
    text = near_far_text(near_section())
    opened = []
    for number, noise in enumerate(((3.0, 1.5), (1.0, 4.0))):
        folder = shared_path / str(number)
        if team.is_root:
            write_pairs(folder, noise=noise)
            (folder / "case.toml").write_text(text, encoding="utf-8")
        team.wait_for_all()
        opened.append(open_inputs(team, load_case(folder / "case.toml")))
    with session_of(team, opened[0][0]) as session:
        assert not session.problem.is_set_up
        first, second = (session.measure(frame) for _, frame in opened)
        n_own = len(session.problem.reference.subdomains)
        assert session.problem.solver.n_factorized == n_own
    # Weights are part of the operators: they stay those of the first frame.
    assert first.noise == second.noise == session.problem.noise
    np.testing.assert_allclose(first.noise, (3.0, 1.5), rtol=0.15)


@pytest.mark.parallel([1, 3])
def test_a_session_that_is_closed_measures_nothing(shared_path: Path) -> None:
    team = Team.world()
    write_frames(team, shared_path, BLOCKS + REGULARIZED)
    inputs, frames = open_frames(team, shared_path)
    session = session_of(team, inputs)
    session.close()
    session.close()
    with pytest.raises(RuntimeError):
        session.measure(frames[0])

"""A series: its frames are those of pairs, wherever it was interrupted, and one that fails loses no other."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.case.loader import load_case
from ddic.errors import ConvergenceError, InputError, StoppedError, as_collective
from ddic.io.series_reader import SeriesResult, read_series
from ddic.methods import series as series_of_frames
from ddic.methods.run import run_case, run_file
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.results.summary import SeriesSummary
from ddic.synth.fields import Sinusoidal
from support.cases import Ears, write_case, write_images
from support.interrupted import assert_equal_results, interrupt
from support.pictures import pair_of

RANKS = [1, 3]
N_FRAMES = 4
SOLVER = '[solver]\nmethod = "dual"\nsubdomains = 4\ntolerance = 1e-12\ninexact = false\n'
TIGHT = SOLVER + "[gauss_newton]\ntolerance = 1e-13\nrms_tolerance = 1e-9\n"
SMOOTH = TIGHT + "[regularization]\ncut_off_wavelength = 48\n"
INTERVAL = "frame_interval = 0.5"
SERIES = [f'"g_{number}.tif"' for number in range(1, N_FRAMES + 1)]


class AsksAt(Ears):
    """A listener that asks the last rank to stop when a frame begins to iterate, as a signal does."""

    def __init__(self, team: Team, last: int) -> None:
        super().__init__()
        self.team, self.last = team, last

    def iteration(self, record: Any) -> None:
        super().iteration(record)
        if self.frames[-1] == self.last and self.team.rank == self.team.size - 1:
            self.team.stop.asked = True


def field(share: float) -> Sinusoidal:
    """Half a pixel of translation a frame, and waves that grow."""
    return Sinusoidal((0.4 * share, -0.3 * share), (0.2 * share, 0.15 * share), (256.0, 320.0), (320.0, 256.0))


def write_frames(folder: Path, more: str = TIGHT, *, blank: int = 0, images: str = "") -> Path:
    """A case with its images; collective."""
    if MPI.COMM_WORLD.rank == 0:
        folder.mkdir(exist_ok=True)
        write_images(folder, field(0.0))
        for number in range(1, N_FRAMES + 1):
            deformed = pair_of(field(number), 192, 8).deformed
            tifffile.imwrite(folder / f"g_{number}.tif", np.full_like(deformed, 90) if number == blank else deformed)
        text = write_case(folder, more, images=images).read_text(encoding="utf-8")
        listed = text.replace('deformed = "g.tif"', f"deformed = [{', '.join(SERIES)}]")
        (folder / "case.toml").write_text(listed, encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    return folder / "case.toml"


def run(path: Path, *, resume: bool = False) -> SeriesSummary:
    summary = run_file(Team.world(), path, Silence(), resume=resume)
    assert isinstance(summary, SeriesSummary)
    MPI.COMM_WORLD.barrier()
    return summary


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The case file of a series that was measured without a break, an image each half a second; collective."""
    root = MPI.COMM_WORLD.rank == 0
    folder = MPI.COMM_WORLD.bcast(tmp_path_factory.mktemp("whole") if root else None)
    path = write_frames(folder / "series", images=INTERVAL)
    summary = run(path)
    assert [frame.number for frame in summary.frames] == [1, 2, 3, 4]
    assert [frame.started_from for frame in summary.frames] == ["a search", "the last frame", "the last two frames",
                                                                "the last two frames"]
    return path


def displacement(series: SeriesResult, step: int) -> NDArray[np.float64]:
    return series[step].displacement


@pytest.mark.parallel(RANKS)
def test_frames_are_those_of_pairs(shared_path: Path, whole: Path) -> None:
    team = Team.world()
    series = read_series(whole.parent / "result.vtkhdf")
    np.testing.assert_array_equal(series.times, [0.5, 1.0, 1.5, 2.0])
    for number in range(1, N_FRAMES + 1):
        alone = shared_path / f"pair_{number}"
        if team.is_root:
            alone.mkdir(exist_ok=True)
            for name in ("f.tif", f"g_{number}.tif"):
                (alone / name).write_bytes((whole.parent / name).read_bytes())
            write_case(alone, TIGHT, deformed=f"g_{number}.tif")
        team.comm.barrier()
        run_case(team, alone / "case.toml", Silence())
        team.comm.barrier()
        expected = read_series(alone / "result.vtkhdf")[0]
        # Gauss-Newton to 1e-9 px from another start.
        np.testing.assert_allclose(displacement(series, number - 1), expected.displacement, atol=1e-8)
        for name in ("strain_green_lagrange", "nodal_von_mises_strain"):
            np.testing.assert_allclose(series[number - 1].fields[name], expected.fields[name], atol=1e-8)
        assert series[number - 1].attributes["provenance"]["deformed_path"].endswith(f"g_{number}.tif")
        assert series[number - 1].attributes["time"]["deformed"] == 0.5 * number
    assert sorted(entry.name for entry in whole.parent.iterdir() if entry.suffix not in (".tif", ".toml")) == [
        "result.json", "result.vtkhdf"]


@pytest.mark.parallel(RANKS)
def test_a_signal_ends_it_after_the_frame_at_hand(shared_path: Path, whole: Path) -> None:
    parts = write_frames(shared_path / "parts", images=INTERVAL)
    team = Team.world()
    with pytest.raises(StoppedError, match=r"after 2 of 4 frames, of which 2 are in .*--resume measures the rest"):
        run_file(team, parts, AsksAt(team, 2))
    MPI.COMM_WORLD.barrier()
    measured = read_series(parts.parent / "result.vtkhdf")
    assert len(measured.times) == 2
    expected = read_series(whole.parent / "result.vtkhdf")
    for step in (0, 1):
        np.testing.assert_array_equal(displacement(measured, step), displacement(expected, step))
    assert run(parts, resume=True).n_resumed == 2
    resumed = read_series(parts.parent / "result.vtkhdf")
    for step in range(N_FRAMES):
        np.testing.assert_array_equal(displacement(resumed, step), displacement(expected, step))


@pytest.mark.parallel([2, 4])
def test_groups_measure_what_one_group_does(shared_path: Path) -> None:
    """Frames that are searched for depend on nothing but their images, hence are the same to the last bit."""
    team = Team.world()
    searched = TIGHT + '[series]\nstart = "search"\n'
    grouped = write_frames(shared_path / "grouped", searched + "groups = 2\n")
    assert [frame.number for frame in run(grouped).frames] == [1, 2, 3, 4]
    alone = write_frames(shared_path / "alone", searched)
    with team.in_groups(2) as (group, own):
        # As many ranks as each group had.
        if group == 0:
            run_file(own, alone, Silence())
    team.comm.barrier()
    found, expected = (read_series(path.parent / "result.vtkhdf") for path in (grouped, alone))
    for step in range(N_FRAMES):
        np.testing.assert_array_equal(displacement(found, step), displacement(expected, step))
    assert not (grouped.parent / "result.frames").exists()


@pytest.mark.parallel([2])
def test_a_part_of_the_frames_is_tracked_and_resumed_by_its_group(shared_path: Path) -> None:
    team = Team.world()
    path = write_frames(shared_path / "parts", TIGHT + "[series]\ngroups = 2\n")
    whole = run(path)
    assert [frame.started_from for frame in whole.frames] == ["a search", "the last frame"] * 2
    expected = read_series(path.parent / "result.vtkhdf")
    # The second group alone is asked, and stops after its first frame.
    again = write_frames(shared_path / "again", TIGHT + "[series]\ngroups = 2\n")
    team.stop.asked = team.rank == 1
    with pytest.raises(StoppedError, match="after 3 of 4 frames"):
        run_file(team, again, Silence())
    team.stop.asked = False
    team.comm.barrier()
    assert run(again, resume=True).n_resumed == 3
    found = read_series(again.parent / "result.vtkhdf")
    for step in range(N_FRAMES):
        np.testing.assert_array_equal(displacement(found, step), displacement(expected, step))


@pytest.mark.parallel([2])
def test_an_error_of_one_group_is_raised_on_all_ranks(shared_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measure = series_of_frames.measure_frames

    def fail_late(team: Team, images: Any, numbers: list[int], *rest: Any) -> Any:
        if numbers[0] > 1:
            raise as_collective(InputError("no frame of the second group"))
        return measure(team, images, numbers, *rest)

    monkeypatch.setattr(series_of_frames, "measure_frames", fail_late)
    path = write_frames(shared_path, TIGHT + "[series]\ngroups = 2\n")
    with pytest.raises(InputError, match="no frame of the second group"):
        run_file(Team.world(), path, Silence())
    # What the other group has measured is kept.
    assert len(list((path.parent / "result.frames").glob("*.vtkhdf"))) == 2


@pytest.mark.parametrize(("more", "reason"), [
    ("groups = 5\n", "5 groups for 4 images"),
    ('groups = 2\nincremental = "always"\n', 'goes with series.incremental = "never"'),
    ('groups = 2\n[[near]]\nreference = "f.tif"\ndeformed = ["f.tif", "f.tif", "f.tif", "f.tif"]\n'
     "ratio = 1.0\noffset = [0, 0]\nregion = [40, 40, 80, 80]\n", r"leave groups or \[\[near\]\] out"),
], ids=["many", "updates", "cameras"])
def test_what_does_not_go_with_groups_is_refused(tmp_path: Path, more: str, reason: str) -> None:
    path = write_frames(tmp_path, TIGHT + "[series]\n" + more)
    with pytest.raises(InputError, match=rf"series\.groups.*{reason}"):
        load_case(path)


@pytest.mark.parallel([3])
def test_ranks_that_make_no_equal_groups_are_refused(shared_path: Path) -> None:
    path = write_frames(shared_path, TIGHT + "[series]\ngroups = 2\n")
    with pytest.raises(InputError, match=r"series.groups: 2 equal groups cannot be made of 3 MPI ranks"):
        run_file(Team.world(), path, Silence())


def check_resumed(whole: Path, parts: Path) -> None:
    """A series that ends in its third frame, and is resumed, equals one that was measured without a break."""
    interrupt(parts, 3)
    assert sorted(path.name for path in (parts.parent / "result.frames").iterdir()) == [
        "000001.vtkhdf", "000002.vtkhdf", "series.json"]
    assert not (parts.parent / "result.vtkhdf").exists()
    summary = run(parts, resume=True)
    assert summary.n_resumed == 2
    assert [frame.started_from for frame in summary.frames][2:] == ["the last two frames"] * 2
    assert_equal_results(whole.parent / "result.vtkhdf", parts.parent / "result.vtkhdf")


@pytest.mark.parallel(RANKS)
def test_what_is_resumed_equals_what_was_not_interrupted(shared_path: Path, whole: Path) -> None:
    check_resumed(whole, write_frames(shared_path / "parts", images=INTERVAL))


@pytest.mark.parallel(RANKS)
def test_what_is_resumed_with_regularization_equals_what_was_not_interrupted(shared_path: Path) -> None:
    smooth, parts = (write_frames(shared_path / name, SMOOTH) for name in ("whole", "parts"))
    run(smooth)
    check_resumed(smooth, parts)


@pytest.mark.parallel([1, 3])
def test_other_subdomains_search_for_the_next_frame(shared_path: Path) -> None:
    path = write_frames(shared_path / "series")
    interrupt(path, 3)
    if MPI.COMM_WORLD.rank == 0:
        # As if it had been run on other ranks: the case asks for as many subdomains, but a frame holds others.
        for frame in (path.parent / "result.frames").glob("*.vtkhdf"):
            with h5py.File(frame, "r+") as file:
                del file["series/unknowns/000003"]
    MPI.COMM_WORLD.barrier()
    summary = run(path, resume=True)
    assert [frame.started_from for frame in summary.frames][2:] == ["a search", "the last frame"]
    off = displacement(read_series(path.parent / "result.vtkhdf"), 3) - field(4).displacement(
        read_series(path.parent / "result.vtkhdf")[3].mesh.nodes)
    # Rounding to 8 bits leaves 0.01 px on elements of 16 px.
    assert np.abs(off).max() < 0.1


@pytest.mark.parallel([1, 3])
def test_a_frame_that_cannot_be_measured_loses_no_other(shared_path: Path) -> None:
    path = write_frames(shared_path / "series", blank=2)
    with pytest.raises(ConvergenceError, match=r"1 of 4 frames could not be measured: frame 2: .*the others are in"):
        run(path)
    MPI.COMM_WORLD.barrier()
    series = read_series(path.parent / "result.vtkhdf")
    np.testing.assert_array_equal(series.numbers, [1, 3, 4])
    np.testing.assert_array_equal(series.times, [1.0, 3.0, 4.0])
    assert [record["converged"] for record in series.records] == [True, False, True, True]
    # From the frames before and after the one that is missing.
    assert series.records[3]["started_from"] == "the last two frames"
    summary = json.loads((path.parent / "result.json").read_text(encoding="utf-8"))
    assert not summary["converged"]
    assert summary["frames"][1]["failure"]
    assert not (path.parent / "result.frames").exists()


def test_a_finished_series_is_not_measured_again(tmp_path: Path) -> None:
    path = write_frames(tmp_path / "series")
    run(path)
    before = (tmp_path / "series" / "result.vtkhdf").stat().st_mtime_ns
    summary = run(path, resume=True)
    assert summary.n_resumed == N_FRAMES
    assert (tmp_path / "series" / "result.vtkhdf").stat().st_mtime_ns == before
    # Without --resume it is.
    assert run(path).n_resumed == 0
    assert (tmp_path / "series" / "result.vtkhdf").stat().st_mtime_ns > before


def test_an_unfinished_series_is_neither_lost_nor_mixed_with_another(tmp_path: Path) -> None:
    path = write_frames(tmp_path / "series")
    interrupt(path, 3)
    with pytest.raises(InputError, match=r"result\.frames holds 2 of 4 frames .* --resume"):
        run(path)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("element_size = 16", "element_size = 18"), encoding="utf-8")
    with pytest.raises(InputError, match=r"frames of another series \(case file differ\)"):
        run(path, resume=True)
    path.write_text(text, encoding="utf-8")
    assert run(path, resume=True).n_resumed == 2


def test_a_pair_is_not_resumed_and_a_series_is_no_pair(tmp_path: Path) -> None:
    write_images(tmp_path)
    path = write_case(tmp_path)
    with pytest.raises(InputError, match=r"--resume: .* one deformed image"):
        run_file(Team.alone(), path, Silence(), resume=True)
    series = write_frames(tmp_path / "series")
    with pytest.raises(InputError, match=r"images\.deformed: names a series"):
        run_case(Team.alone(), series, Silence())


def test_a_start_that_leads_nowhere_is_searched_for(tmp_path: Path) -> None:
    path = write_frames(tmp_path / "series")
    # The third frame jumps by half of the region.
    shifted = Sinusoidal((60.0, 0.0), (0.5, 0.4), (256.0, 320.0), (320.0, 256.0))
    wide = path.read_text(encoding="utf-8").replace("region = [24, 24, 168, 168]", "region = [24, 24, 104, 168]")
    path.write_text(wide, encoding="utf-8")
    tifffile.imwrite(path.parent / "g_3.tif", pair_of(shifted, 192, 8).deformed)
    ears = Ears()
    summary = run_file(Team.alone(), path, ears)
    assert isinstance(summary, SeriesSummary)
    assert summary.frames[2].started_from == "a search"
    assert any("it is searched for" in note for note in ears.notes)
    assert ears.frames == [1, 2, 3, 4]
    result = read_series(path.parent / "result.vtkhdf")[2]
    assert np.abs(result.displacement - shifted.displacement(result.mesh.nodes)).max() < 0.1

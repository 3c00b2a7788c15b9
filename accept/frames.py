"""Many frames in one session against separate runs: how often M is assembled, memory, time, and the field.

Under MPI, as python -m accept.frames TASK, frames are measured in one session and rank 0 prints a JSON line for each.
TASK is a JSON object with "case" (a case file), "deformed" (an image for each frame), "keep" (frames, from 1, whose
displacement is kept), "folder" (where it goes) and "from_last" (whether a frame starts from the field of the one
before).
"""

from __future__ import annotations

import gc
import json
import resource
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from mpi4py import MPI

from accept.support.settings import describe_settings
from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_run, images, run_job
from ddic.case.loader import load_case
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs, open_inputs
from ddic.io.result_reader import read_result
from ddic.methods.dd_dic import DecomposedSession
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.problem.residual_model import open_frame_views
from ddic.results.listener import Silence
from ddic.results.measurement import Measurement
from ddic.results.publishing import gather

JOB = "accept.frames"
SAME_FIELD_PX = 1e-6
"""Largest difference of a displacement component from a separate run's, pixels."""

MOST_GROWTH = 0.02
"""Growth of the resident memory of all ranks from an early frame to the last, as a share."""

EARLY = 5
"""Frame after which memory should not grow."""

N_RANKS, SUBDOMAINS = 2, 8
MARGIN = 20
"""Edge of the reference image without elements, pixels."""

SEED = 4
"""One seed: all pairs have the same reference image."""


@dataclass(frozen=True)
class Series:
    """Frames of one specimen.

    Attributes
    ----------
    name : str
        Of its folder.
    size : int
        Side of the images, pixels.
    element : int
        Side of the elements, pixels.
    wavelength : int
        Cut-off wavelength, pixels.
    n_frames : int
        Number of frames.
    stretch : float
        Strain along x that the last frame has.
    shift : float
        Displacement of the middle along x that the last frame has, as a share of the specimen's width.
    not_controlled : str
        Edges whose forces are unknown, as a case file lists them. What leaves the image is found by equilibrium alone,
        which takes free edges.
    from_last : bool
        Whether a frame starts from the field of the one before, which is within a pixel where steps are small.
    """

    name: str
    size: int
    element: int
    wavelength: int
    n_frames: int
    stretch: float
    shift: float
    not_controlled: str = '["boundary"]'
    from_last: bool = True

    def arguments(self, frame: int) -> list[str]:
        """Give the arguments of ``ddic synth`` of a frame."""
        share = frame / self.n_frames
        strain = self.stretch * share
        # A tenth of a pixel off, so that no pixel lies on the image's edge but for rounding.
        shift = self.shift * (self.size - 2 * MARGIN) * share + 0.1
        return ["affine", "--gradient", f"{strain:.6f}", "0", "0", f"{-0.3 * strain:.6f}", "--vector", f"{shift:.3f}",
                "0.3", "--size", f"{self.size}x{self.size}", "--noise", "1", "--seed", str(SEED)]

    def case(self, folder: Path, frame: int) -> str:
        """Give the case file of a frame."""
        end = MARGIN + self.element * ((self.size - 2 * MARGIN) // self.element)
        return (f'[images]\nreference = "{folder}/1/reference.tif"\ndeformed = "{folder}/{frame}/deformed.tif"\n'
                f"[mesh.structured]\nregion = [{MARGIN}, {MARGIN}, {end}, {end}]\nelement_size = {self.element}\n"
                f"[regularization]\ncut_off_wavelength = {self.wavelength}\nnot_controlled = {self.not_controlled}\n"
                f'[solver]\nmethod = "dual"\nsubdomains = {SUBDOMAINS}\ntolerance = 1e-10\n'
                "[gauss_newton]\ntolerance = 1e-12\nrms_tolerance = 1e-9\nmax_iterations = 2000\n")

    @property
    def settings(self) -> str:
        """Ranks, and what the case says that is not the default."""
        return f"{N_RANKS} ranks, {describe_settings(self.case(Path(), 1))}"


STAYING = Series("frames", 1000, 20, 80, 50, 0.02, 0.005)
LEAVING = Series("leaving_frames", 1000, 20, 80, 20, 0.0, 0.25, '["left"]', False)
SMALL_STAYING = Series("frames", 240, 20, 80, 3, 0.01, 0.005)
SMALL_LEAVING = Series("leaving_frames", 240, 20, 80, 3, 0.0, 0.25, '["left"]', False)


@dataclass(frozen=True)
class Measured:
    """What a session and separate runs found.

    Attributes
    ----------
    frames : list of dict
        What the job printed of each frame.
    difference : float
        Largest difference of a displacement component from a separate run's, pixels.
    compared : tuple of int
        Frames that were measured separately.
    separate_s : float
        Median seconds of a separate run, its start included.
    """

    frames: list[dict[str, Any]]
    difference: float
    compared: tuple[int, ...]
    separate_s: float

    @property
    def last(self) -> dict[str, Any]:
        """What the job printed of the last frame."""
        return self.frames[-1]

    @property
    def later_s(self) -> float:
        """Median seconds of the frames after the first."""
        return float(median(frame["seconds"] for frame in self.frames[1:]))


def measure_many_frames(scale: Scale) -> list[Row]:
    """Measure frames that all stay in the image: nothing of the reference is done twice."""
    series = SMALL_STAYING if scale.smoke else STAYING
    found = _measure(series, scale.folder(series.name))
    what = f"{series.n_frames} frames in one session, {series.size} x {series.size} px, {series.settings}"
    assembled, factorized = found.last["n_assembled"], found.last["n_factorized"]
    early = found.frames[min(EARLY, series.n_frames - 1) - 1]
    growth = found.last["resident_bytes"] / early["resident_bytes"] - 1
    return [
        Row(f"{what}: M and factors of {SUBDOMAINS} subdomains", "each assembled once, factorised once",
            f"{assembled} assembled, {factorized} factorised", assembled == factorized == SUBDOMAINS),
        _field_row(what, found),
        Row(f"{what}: memory of all ranks after frame {series.n_frames} against that after frame {early['frame']}",
            f"within {MOST_GROWTH:.0%}", f"{found.last['resident_bytes'] / 2**20:.0f} against "
            f"{early['resident_bytes'] / 2**20:.0f} MiB ({growth:+.2%})", growth <= MOST_GROWTH, judged_small=False),
        _time_row(what, found),
    ]


def measure_leaving_frames(scale: Scale) -> list[Row]:
    """Measure frames that a quarter of the specimen leaves: operators are renewed only where pixels go."""
    series = SMALL_LEAVING if scale.smoke else LEAVING
    found = _measure(series, scale.folder(series.name))
    what = (f"{series.n_frames} frames of which a quarter of the specimen leaves the image, {series.size} x "
            f"{series.size} px, {series.settings}")
    renewed = {s for frame in found.frames for s in frame["renewed"]}
    losing = {s for frame in found.frames for s in frame["losing"]}
    n_renewals = sum(len(frame["renewed"]) for frame in found.frames)
    return [
        Row(f"{what}: M and factors of {SUBDOMAINS} subdomains", "renewed only in subdomains that lose pixels",
            f"{n_renewals} renewals in {series.n_frames} frames, of subdomains {sorted(renewed)}; pixels are lost by "
            f"{sorted(losing)}", bool(renewed) and renewed <= losing),
        _field_row(what, found),
        _time_row(what, found),
    ]


def _field_row(what: str, found: Measured) -> Row:
    return Row(f"{what}: field against separate runs of frames {', '.join(map(str, found.compared))}",
               f"largest difference <= {SAME_FIELD_PX:.0e} px", f"{found.difference:.1e} px",
               found.difference <= SAME_FIELD_PX)


def _time_row(what: str, found: Measured) -> Row:
    return Row(f"{what}: time of a frame after the first", "reported beside that of a separate run",
               f"{found.later_s:.2f} s (first {found.frames[0]['seconds']:.2f} s, preparation "
               f"{found.frames[0]['preparation_seconds']:.2f} s); a separate run {found.separate_s:.2f} s", True,
               judged_small=False)


def _measure(series: Series, folder: Path) -> Measured:
    """Measure the series in one session and some of its frames separately."""
    for frame in range(1, series.n_frames + 1):
        images(*series.arguments(frame), folder=folder / str(frame))
    compared = _choose(series.n_frames)
    case = folder / "session.toml"
    case.write_text(series.case(folder, 1), encoding="utf-8")
    deformed = [str(folder / str(frame) / "deformed.tif") for frame in range(1, series.n_frames + 1)]
    task = {"case": str(case), "deformed": deformed, "keep": list(compared), "folder": str(folder),
            "from_last": series.from_last}
    frames = run_job(N_RANKS, JOB, json.dumps(task))
    for record in frames:
        append_result("frames_runs", {"series": series.name, **record})
    differences, seconds = [], []
    for frame in compared:
        begin = time.perf_counter()
        ddic_run(series.case(folder, frame), folder, N_RANKS, f"separate_{frame}")
        seconds.append(time.perf_counter() - begin)
        alone = read_result(folder / f"separate_{frame}.vtkhdf").displacement
        in_session = np.load(folder / f"session_{frame}.npy")
        differences.append(float(np.abs(in_session - alone).max()))
    found = Measured(frames, max(differences), compared, float(median(seconds)))
    append_result("frames_runs", {"series": series.name, **{k: v for k, v in asdict(found).items() if k != "frames"}})
    return found


def _choose(n_frames: int) -> tuple[int, ...]:
    """The first frame, the last, and two between."""
    between: Sequence[int] = (n_frames // 3, 2 * n_frames // 3)
    return tuple(sorted({1, *(k for k in between if k > 1), n_frames}))


PAGE = resource.getpagesize()


def measure_resident() -> int:
    """Measure the resident memory of this process.

    Returns
    -------
    int
        Bytes.
    """
    gc.collect()
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * PAGE


def find_losing(inputs: Inputs, frame: Frame, session: DecomposedSession, measurement: Measurement) -> list[int]:
    """Find the owned subdomains some of whose pixels a frame does not show.

    Parameters
    ----------
    inputs : Inputs
        Settings.
    frame : Frame
        The deformed images.
    session : DecomposedSession
        With the reference's pixels.
    measurement : Measurement
        Of the frame.

    Returns
    -------
    list of int
        Their numbers.
    """
    losing = []
    views = open_frame_views(inputs.case, frame, session.problem.reference.views)
    for subdomain, (view,), q in zip(session.problem.reference.subdomains, views, measurement.q, strict=True):
        if view.without_hidden(q).n_pixels < view.n_pixels:
            losing.append(subdomain.index)
    return losing


def measure_frames(team: Team, task: dict[str, Any]) -> None:
    """Measure all frames; collective."""
    loaded = load_case(Path(task["case"]))
    begin = time.perf_counter()
    inputs, _ = open_inputs(team, loaded)
    last: Measurement | None = None
    with DecomposedSession(team, inputs, Silence(), PhaseClock()) as session:
        preparation = time.perf_counter() - begin
        for number, deformed in enumerate(task["deformed"], start=1):
            section = loaded.case.imaging.model_copy(update={"deformed": Path(deformed)})
            _, frame = open_inputs(team, replace(loaded, case=loaded.case.model_copy(update={"images": section})))
            before = list(session.problem.solver.assembly.systems)
            team.wait_for_all()
            begin = time.perf_counter()
            last = session.measure(frame, last.q if last and task["from_last"] else None)
            team.wait_for_all()
            seconds = time.perf_counter() - begin
            record = describe(team, session, before)
            record |= {"frame": number, "seconds": seconds, "preparation_seconds": preparation,
                       "iterations": len(last.records),
                       "losing": team.gather_lists(find_losing(inputs, frame, session, last))}
            # Of every frame, as a user has it: what it takes must be free again with the next one.
            displacement = gather(last).displacement
            if number in task["keep"] and team.is_root:
                np.save(Path(task["folder"]) / f"session_{number}.npy", displacement)
            if team.is_root:
                print(json.dumps(record), flush=True)


def describe(team: Team, session: DecomposedSession, before: list[Any]) -> dict[str, Any]:
    """Say what a session has done so far, summed over ranks; collective."""
    problem = session.problem
    renewed = [system.subdomain.index for old, system in zip(before, problem.solver.assembly.systems, strict=True)
               if system is not old]
    return {"n_assembled": sum(team.gather_lists([problem.n_assembled])),
            "n_factorized": sum(team.gather_lists([problem.solver.n_factorized])),
            "renewed": team.gather_lists(renewed),
            "resident_bytes": sum(team.gather_lists([measure_resident()]))}


if __name__ == "__main__":
    measure_frames(Team(MPI.COMM_WORLD), json.loads(sys.argv[1]))

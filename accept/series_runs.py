"""Series of images: how fast frames come, what killed runs lose and go on from, a real test as a series."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import psutil
from numpy.typing import NDArray

from accept.real_images import case_text
from accept.support.deformed_pair import REPEATABLE, Frames, describe_case, write_frames
from accept.support.settings import describe_settings
from accept.table import Scale
from bench.support.rows import Row, append_result
from bench.support.runs import ROOT, TIMEOUT_S, ddic_command, ddic_run, environment, mpirun, real_data
from ddic.io.series_reader import read_series

OF_TIME = ("history/phases", "series/records")
"""Parts of the names of datasets of seconds and what follows from them, which no run repeats."""


def find_unequal_datasets(one: Path, other: Path) -> tuple[int, list[str]]:
    """Compare all datasets of two result files to the last bit, but those of seconds."""
    first, second = _read(one), _read(other)
    missing = set(first) ^ set(second)
    unequal = [name for name in set(first) & set(second) if not _are_equal(first[name], second[name])]
    return len(first), sorted([*missing, *unequal])


def _read(path: Path) -> dict[str, NDArray[Any]]:
    found: dict[str, NDArray[Any]] = {}

    def keep(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and not any(part in name for part in OF_TIME):
            found[name] = np.asarray(item[()])

    with h5py.File(path) as file:
        file.visititems(keep)
    return found


def _are_equal(one: NDArray[Any], other: NDArray[Any]) -> bool:
    may_be_nan = one.dtype.kind == "f" and other.dtype.kind == "f"
    return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=may_be_nan)


SERIES, SMOKE_SERIES = (54, 58, 62, 66, 70), (54, 58)
"""Frames of the open-hole test, all compared with frame 53."""

MOST_SHARE = 0.5
"""Time of the series over that of its frames measured one by one."""

N_ROUNDS = 3
"""Times that both are timed, in turn."""

FAST, SMOKE_FAST = Frames((2448, 2048), 200, 20.0), Frames((240, 200), 6, 4.0)
ELEMENT, SMALL_ELEMENT = 16, 10
LEAST_RATE, MOST_GROWTH = 4.0, 1.05
"""Frames a second after the first; memory of a rank at the end over that at a tenth of the frames."""

LEAST_OF_PYVALE = 14.0
"""CPU seconds of pyvale for the middle frame over ddic's a frame."""

LARGEST_ERROR = 0.1
"""Of a node in the last frame, pixels: the images have noise of 1 grey level."""

KILLED_FRAME, POLL_S = 3, 0.005


def measure_openhole(scale: Scale) -> list[Row]:
    """Measure a real test as a series, and its frames one by one."""
    folder, numbers = scale.folder("openhole_series"), SMOKE_SERIES if scale.smoke else SERIES
    times: dict[str, list[float]] = {"series": [], "one by one": []}
    converged = True
    for _ in range(1 if scale.smoke else N_ROUNDS):
        shutil.rmtree(folder, ignore_errors=True)
        summary, seconds = _time_run(_openhole(*numbers), folder, "series")
        times["series"].append(seconds)
        converged &= bool(summary["converged"])
        alone = [_time_run(_openhole(number), folder, f"alone_{number}")[1] for number in numbers]
        times["one by one"].append(sum(alone))
    append_result("series_openhole", times)
    share = float(np.median(times["series"]) / np.median(times["one by one"]))
    iterations = ", ".join(str(frame["iterations"]) for frame in summary["frames"])
    return [Row(f"openhole, frame 53 to {', '.join(map(str, numbers))} as a series on 2 ranks, "
                f"{describe_settings(_openhole(*numbers))}",
                f"every frame converges; at most {MOST_SHARE} of the time of separate runs",
                f"{'all converge' if converged else 'not all converge'} ({iterations} iterations); "
                f"{np.median(times['series']):.1f} s, {share:.2f} times {np.median(times['one by one']):.1f} s",
                converged and share <= MOST_SHARE, judged_small=False)]


def _openhole(*numbers: int) -> str:
    """The case of a pair, or of several frames."""
    names = [f'"{real_data()}/openhole/zoom-{number:04d}_1.tif"' for number in numbers]
    deformed = names[0] if len(names) == 1 else f"[{', '.join(names)}]"
    text = case_text("subdomains = 8")
    return text.replace(f'deformed = "{real_data()}/openhole/zoom-0070_1.tif"', f"deformed = {deformed}")


def _time_run(case: str, folder: Path, name: str) -> tuple[dict[str, Any], float]:
    began = time.perf_counter()
    summary = ddic_run(case, folder, 2, name)
    return summary, time.perf_counter() - began


@dataclass
class _Watched:
    """What was seen of a run: when each frame began, the largest process's memory then, all ranks' CPU seconds."""

    began: dict[int, float] = field(default_factory=dict)
    memory: dict[int, int] = field(default_factory=dict)
    cpu: dict[int, float] = field(default_factory=dict)
    end: float = 0.0


def measure_rate(scale: Scale) -> list[Row]:
    """Measure how many frames a second are measured and written, and whether memory grows."""
    frames, element = (SMOKE_FAST, SMALL_ELEMENT) if scale.smoke else (FAST, ELEMENT)
    folder = scale.folder("series_rate")
    seen = _watch_series(frames, element, folder)
    rate = (frames.n_frames - 1) / (seen.end - seen.began[2])
    early = max(2, frames.n_frames // 10)
    growth = seen.memory[frames.n_frames] / seen.memory[early]
    series = read_series(folder / "rate.vtkhdf")
    last = series[-1]
    deformation = frames.make_deformation(frames.n_frames)
    error = float(np.abs(last.displacement - deformation.displacement(last.mesh.nodes)).max())
    append_result("series_rate", {"rate": rate, "growth": growth, "error": error, "n_frames": frames.n_frames})
    beside = "" if scale.smoke else f"; pyvale on the middle frame: {_time_pyvale(folder, frames):.1f} CPU s"
    width, height = frames.size
    megabytes = seen.memory[frames.n_frames] / 2**20
    return [Row(f"{frames.n_frames} frames of {width} x {height} px, 8 bit, {element}-px Q4, motion growing to "
                f"{frames.largest:g} px, default settings, 2 ranks",
                f"at least {LEAST_RATE:g} frames a second after the first, fields and strains written; memory constant "
                f"(within {MOST_GROWTH:g}); no node off by more than {LARGEST_ERROR} px",
                f"{rate:.1f} frames a second; memory of the larger rank {growth:.3f} times that at frame {early}, "
                f"{megabytes:.0f} MiB; largest error {error:.3f} px{beside}",
                rate >= LEAST_RATE and growth <= MOST_GROWTH and error <= LARGEST_ERROR
                and len(series) == frames.n_frames, judged_small=False)]


def measure_beside_pyvale(scale: Scale) -> list[Row]:
    """Compare CPU seconds a frame with those of pyvale on the middle frame."""
    from bench.support.peer_environment import peers_are_there

    frames, element = (SMOKE_FAST, SMALL_ELEMENT) if scale.smoke else (FAST, ELEMENT)
    folder = scale.folder("series_rate")
    seen = _watch_series(frames, element, folder)
    # From the second frame's begin to the last one's: the first finds its start on coarse images.
    own = (seen.cpu[frames.n_frames] - seen.cpu[2]) / (frames.n_frames - 2)
    rate = (frames.n_frames - 1) / (seen.end - seen.began[2])
    width, height = frames.size
    what = (f"series of {frames.n_frames} frames of {width} x {height} px, 2 ranks, strains written: pyvale's CPU for "
            "the middle frame over ddic's a frame")
    bound, told = f"at least {LEAST_OF_PYVALE:g}", f"{own:.2f} CPU s a frame, {rate:.1f} frames a second"
    if scale.smoke and not peers_are_there():
        return [Row(what, bound, f"ddic alone: {told}", True, judged_small=False)]
    theirs = _time_pyvale(folder, frames)
    append_result("series_rate", {"cpu_a_frame": own, "rate": rate, "pyvale_cpu": theirs})
    return [Row(what, bound, f"{theirs / own:.1f} times: {theirs:.2f} CPU s; {told}", theirs >= LEAST_OF_PYVALE * own,
                judged_small=False)]


def _watch_series(frames: Frames, element: float, folder: Path) -> _Watched:
    """Measure a series whose images are made where they are not there."""
    write_frames(frames, folder)
    for left in ("rate.vtkhdf", "rate.json"):
        (folder / left).unlink(missing_ok=True)
    case = folder / "rate.toml"
    case.write_text(f'{describe_case(frames, element)}\n[output]\nfile = "rate.vtkhdf"\n', encoding="utf-8")
    return _watch(case)


def _watch(case: Path) -> _Watched:
    """Run a case on 2 ranks and look at it when a frame begins."""
    seen = _Watched()
    process = subprocess.Popen(_command(case), cwd=ROOT, text=True, stdout=subprocess.PIPE, env=environment())
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("frame ") and " of " in line:
            number = int(line.split()[1])
            seen.began[number] = time.perf_counter()
            ranks = _list_ranks(process.pid)
            seen.memory[number] = max((_read_memory(rank) for rank in ranks), default=0)
            seen.cpu[number] = sum(_read_cpu(rank) for rank in ranks)
        elif line.startswith("result: "):
            seen.end = time.perf_counter()
    if process.wait() != 0:
        raise RuntimeError(f"{case} ended with {process.returncode}")
    return seen


def _command(case: Path, *words: str) -> list[str]:
    launcher = os.environ.get("MPIEXEC", "mpiexec")
    return ["timeout", str(TIMEOUT_S), launcher, "-n", "2", ddic_command(), "run", str(case), *words]


def _list_ranks(pid: int) -> list[psutil.Process]:
    return [child for child in psutil.Process(pid).children(recursive=True) if "ddic" in " ".join(child.cmdline())
            and "mpiexec" not in child.name() and "mpirun" not in child.name()]


def _read_memory(process: psutil.Process) -> int:
    return int(process.memory_info().rss)


def _read_cpu(process: psutil.Process) -> float:
    used = process.cpu_times()
    return float(used.user + used.system)


def _time_pyvale(folder: Path, frames: Frames) -> float:
    """CPU seconds of pyvale on the middle frame."""
    from bench.peers import QUICK_SUBSETS, Pair, measure_peer

    middle = folder / "pyvale"
    middle.mkdir(exist_ok=True)
    for name, target in (("reference.tif", "reference.tif"), (f"frame_{frames.n_frames // 2}.tif", "deformed.tif")):
        shutil.copyfile(folder / name, middle / target)
    record, *_ = measure_peer("pyvale", Pair(middle, *frames.size, 1), {"settings": QUICK_SUBSETS})
    return float(record["cpu_seconds"])


def measure_killed(scale: Scale) -> list[Row]:
    """Kill a rank, then mpirun, in the middle of a frame, resume, and compare with what was not disturbed."""
    frames = SMOKE_FAST if scale.smoke else Frames((1200, 1000), 6, 6.0)
    folder = scale.folder("series_killed")
    write_frames(frames, folder)
    case = describe_case(frames, SMALL_ELEMENT) + REPEATABLE
    for name in ("whole", "rank", "mpirun"):
        shutil.rmtree(folder / f"{name}.frames", ignore_errors=True)
        for ending in ("vtkhdf", "json"):
            (folder / f"{name}.{ending}").unlink(missing_ok=True)
    ddic_run(case, folder, 2, "whole")
    rows = []
    for victim in ("rank", "mpirun"):
        path = folder / f"{victim}.toml"
        path.write_text(f'{case}\n[output]\nfile = "{victim}.vtkhdf"\n', encoding="utf-8")
        gone = kill_in_frame(path, KILLED_FRAME, victim)
        n_left = len(list((folder / f"{victim}.frames").glob("*.vtkhdf")))
        mpirun(2, ddic_command(), "run", str(path), "--resume")
        _, differing = find_unequal_datasets(folder / "whole.vtkhdf", folder / f"{victim}.vtkhdf")
        n_measured = len(read_series(folder / f"{victim}.vtkhdf"))
        told = "its datasets are equal" if not differing else f"other values in {', '.join(differing)}"
        rows.append(Row(f"{frames.n_frames} frames, {frames.size[0]} x {frames.size[1]} px, 2 ranks: SIGKILL to "
                        f"{'one rank' if victim == 'rank' else 'mpirun'} in frame {KILLED_FRAME}, then --resume; "
                        f"{describe_settings(case)}",
                        "no process left, the result equal to that of an undisturbed run, no frame lost",
                        f"all gone after {gone:.1f} s; {n_left} frames were kept, {n_measured} of {frames.n_frames} "
                        f"are in the result; {told}",
                        n_left >= KILLED_FRAME - 1 and n_measured == frames.n_frames and not differing))
    return rows


def kill_in_frame(case: Path, frame: int, victim: str = "rank", *words: str) -> float:
    """Kill a run on 2 ranks when a frame begins.

    Parameters
    ----------
    case : Path
        Case file of a series.
    frame : int
        Number of the frame.
    victim : str, optional
        "rank" for the last rank, else the launcher.
    *words : str
        Of ``ddic run``.

    Returns
    -------
    float
        Seconds until every process was gone.

    Raises
    ------
    RuntimeError
        Where processes were still there after a minute, or the run ended before that frame.
    """
    process = subprocess.Popen(_command(case, *words), cwd=ROOT, text=True, stdout=subprocess.PIPE,
                               stderr=subprocess.DEVNULL, env=environment())
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(f"frame {frame} of"):
            break
    else:
        raise RuntimeError(f"{case} ended with {process.wait()} before frame {frame}")
    family = psutil.Process(process.pid).children(recursive=True)
    ranks = _list_ranks(process.pid)
    launchers = [child for child in family if child.pid not in {rank.pid for rank in ranks}]
    began = time.perf_counter()
    (ranks[-1] if victim == "rank" else launchers[0]).send_signal(signal.SIGKILL)
    _, alive = psutil.wait_procs(family, timeout=60)
    seconds = time.perf_counter() - began
    for left in alive:
        left.kill()
    process.kill()
    process.wait()
    if alive:
        raise RuntimeError(f"{len(alive)} processes were still there after 60 s")
    return seconds


KILLED_SIZE = (128, 128)
N_FRAMES, EVERY = 300, 20
SMOKE_FRAMES, SMOKE_EVERY = 8, 4
LARGEST_KILLED = 6.0
"""Displacement in the last frame, pixels."""


def measure_resumed_series(scale: Scale) -> list[Row]:
    """Measure a series while a rank is killed every so many frames, resume each time, and compare."""
    n_frames, every = (SMOKE_FRAMES, SMOKE_EVERY) if scale.smoke else (N_FRAMES, EVERY)
    frames, folder = Frames(KILLED_SIZE, n_frames, LARGEST_KILLED), scale.folder("resumed_series")
    write_frames(frames, folder)
    for name in ("whole", "killed"):
        shutil.rmtree(folder / f"{name}.frames", ignore_errors=True)
        for older in folder.glob(f"{name}.*"):
            older.unlink()
    case = describe_case(frames, ELEMENT) + REPEATABLE
    ddic_run(case, folder, 2, "whole")
    path = folder / "killed.toml"
    path.write_text(f'{case}\n[output]\nfile = "killed.vtkhdf"\n', encoding="utf-8")
    seconds: list[float] = []
    n_kept: list[int] = []
    for frame in range(every, n_frames, every):
        seconds.append(kill_in_frame(path, frame, "rank", *(["--resume"] if seconds else [])))
        n_kept.append(len(list((folder / "killed.frames").glob("*.vtkhdf"))))
    mpirun(2, ddic_command(), "run", str(path), "--resume")
    n_compared, unequal = find_unequal_datasets(folder / "whole.vtkhdf", folder / "killed.vtkhdf")
    n_measured = len(read_series(folder / "killed.vtkhdf"))
    left = sorted(one.name for one in folder.iterdir() if one.name.startswith((".", "killed.frames")))
    width, height = KILLED_SIZE
    return [Row(f"{n_frames} frames, {width} x {height} px, 2 ranks: SIGKILL to a rank in every {every}th, --resume "
                "each time",
                "every process gone within 10 s; all frames measured; datasets equal to those of an undisturbed run; "
                "nothing left",
                f"{len(seconds)} killed, all gone after {max(seconds):.1f} s at most; frames kept: "
                f"{', '.join(map(str, n_kept))}; {n_measured} of {n_frames} measured; {len(unequal)} of {n_compared} "
                f"datasets differ{': ' + ', '.join(unequal[:3]) if unequal else ''}; "
                f"{', '.join(left) or 'nothing'} left",
                max(seconds) <= 10 and n_measured == n_frames and not unequal and not left)]

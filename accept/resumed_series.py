"""A long series whose ranks are killed again and again, and that goes on each time."""

from __future__ import annotations

import shutil

from accept.series_runs import kill_in_frame
from accept.support.moving_frames import REPEATABLE, Frames, describe_case, write_frames
from accept.support.same_datasets import find_unequal_datasets
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ddic_command, ddic_run, mpirun
from ddic.io.series_reader import read_series

SIZE, ELEMENT = (128, 128), 16
N_FRAMES, EVERY = 300, 20
SMOKE_FRAMES, SMOKE_EVERY = 8, 4
LARGEST = 6.0
"""Displacement in the last frame, pixels."""


def measure_resumed_series(scale: Scale) -> list[Row]:
    """Measure a series while a rank is killed every so many frames, resume each time, and compare.

    Parameters
    ----------
    scale : Scale
        A smoke run takes few frames.

    Returns
    -------
    list of Row
        One row.
    """
    n_frames, every = (SMOKE_FRAMES, SMOKE_EVERY) if scale.smoke else (N_FRAMES, EVERY)
    frames, folder = Frames(SIZE, n_frames, LARGEST), scale.folder("resumed_series")
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
    return [Row(f"{n_frames} frames, {SIZE[0]} x {SIZE[1]} px, 2 ranks: SIGKILL to a rank in every {every}th, --resume "
                "each time",
                "every process gone within 10 s; all frames measured; datasets equal to those of an undisturbed run; "
                "nothing left",
                f"{len(seconds)} killed, all gone after {max(seconds):.1f} s at most; frames kept: "
                f"{', '.join(map(str, n_kept))}; {n_measured} of {n_frames} measured; {len(unequal)} of {n_compared} "
                f"datasets differ{': ' + ', '.join(unequal[:3]) if unequal else ''}; "
                f"{', '.join(left) or 'nothing'} left",
                max(seconds) <= 10 and n_measured == n_frames and not unequal and not left)]

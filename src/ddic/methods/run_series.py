"""A series of deformed images measured from one reference image; what is finished is never lost."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from ddic.case.frame_files import list_deformed
from ddic.case.loader import LoadedCase
from ddic.errors import ConvergenceError, StoppedError, as_collective
from ddic.io.series_folder import SeriesFolder
from ddic.methods.measure_frames import measure_frames
from ddic.parallel.team import Team
from ddic.results.listener import Listener
from ddic.results.series import FrameRecord, SeriesSummary
from ddic.results.series_images import describe_origin, finish_series, list_frames_to_measure, open_series


def run_series(team: Team, loaded: LoadedCase, listener: Listener, *, resume: bool = False) -> SeriesSummary:
    """Measure the deformed images of a case in order; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    loaded : LoadedCase
        Checked, with several deformed images.
    listener : Listener
        Told what happens.
    resume : bool
        Whether to go on where an earlier run stopped.

    Returns
    -------
    SeriesSummary
        Also written beside the result.

    Raises
    ------
    DdicError
        On all ranks. Where frames could not be measured the others are in the result, and the message says which.
    StoppedError
        On all ranks, where a signal asked one of them to stop; what was measured until then is in the result.
    """
    began = time.perf_counter()
    file, n_frames = loaded.case.output.file, len(list_deformed(loaded.case.images))
    folder = SeriesFolder(file, n_frames)
    origin = describe_origin(loaded)
    texts = team.on_root(lambda: folder.begin(origin, resume=resume))
    before = {number: FrameRecord.from_json(text) for number, text in texts.items()}
    records = [*before.values(), *_measure_rest(team, loaded, folder, before, listener)]
    records.sort(key=lambda record: record.number)
    summary = SeriesSummary(records, n_frames, str(file), time.perf_counter() - began, len(before),
                            {"path": str(loaded.path), "toml": loaded.text})
    team.on_root(lambda: finish_series(folder, summary, origin))
    if not summary.is_whole:
        raise as_collective(StoppedError(_describe_stop(summary)))
    if summary.failures:
        raise as_collective(ConvergenceError(_describe_failures(summary)))
    return summary


def _measure_rest(team: Team, loaded: LoadedCase, folder: SeriesFolder, before: Mapping[int, FrameRecord],
                  listener: Listener) -> Sequence[FrameRecord]:
    """Measure the frames that are not finished; collective."""
    wanted = list_frames_to_measure(team, folder, before)
    if not wanted.numbers:
        return []
    images = open_series(team, loaded, wanted.numbers[0], listener)
    return measure_frames(images, wanted)


def _describe_stop(summary: SeriesSummary) -> str:
    tried = len(summary.frames)
    return (f"stopped by a signal after {tried} of {summary.n_frames} frames, of which {tried - len(summary.failures)} "
            f"are in {summary.result_file or 'no file'}; ddic run --resume measures the rest")


def _describe_failures(summary: SeriesSummary) -> str:
    failures = summary.failures
    reasons = "; ".join(frame.describe() for frame in failures)
    kept = "" if len(failures) == len(summary.frames) else f"; the others are in {summary.result_file}"
    return f"{len(failures)} of {summary.n_frames} frames could not be measured: {reasons}{kept}"

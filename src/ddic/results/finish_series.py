"""The end of a series: its frames joined to one result file, and the summary."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace

from ddic.case.frame_files import list_cameras, list_deformed, list_times
from ddic.case.loader import LoadedCase
from ddic.io.join_frames import join_frames
from ddic.io.replace_on_exit import replaced_together
from ddic.io.result_schema import summary_path
from ddic.io.series_folder import SeriesFolder
from ddic.results.series_record import SeriesSummary, write_series_summary


def describe_origin(loaded: LoadedCase) -> dict[str, object]:
    """Say what a series is measured from, to tell it from others.

    Parameters
    ----------
    loaded : LoadedCase
        The case.

    Returns
    -------
    dict
        As JSON has it.
    """
    sections = list_cameras(loaded.case)
    return {"case file": loaded.text, "reference images": [str(section.reference) for section in sections],
            "deformed images": [[str(path) for path in list_deformed(section)] for section in sections],
            "times": list(list_times(loaded.case))}


def finish_series(folder: SeriesFolder, summary: SeriesSummary, origin: Mapping[str, object]) -> None:
    """Join what was measured, and write the summary; the folder of frames goes once every frame was tried.

    Parameters
    ----------
    folder : SeriesFolder
        Of finished frames; it is not there where an earlier run has finished the series.
    summary : SeriesSummary
        Of the run.
    origin : mapping
        Of ``describe_origin``.

    Raises
    ------
    OSError
        Where one cannot be written; neither is, an earlier result and the frames stay.
    """
    if not folder.path.exists():
        return
    measured = [frame.number for frame in summary.frames if frame.converged]
    with replaced_together() as files:
        if measured:
            records = [frame.as_json() for frame in summary.frames]
            join_frames(folder, measured, records, json.dumps(origin), files)
        else:
            summary = replace(summary, result_file="")
        write_series_summary(summary_path(folder.result), summary, files)
    if summary.is_whole:
        folder.remove()

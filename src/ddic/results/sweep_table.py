"""Tables of a sweep: for people, and as comma-separated values."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.io.replace_on_exit import NewFiles, begin_files
from ddic.plots.sweep import SweptElements
from ddic.results.sweep_trials import Sweep, Trial

COLUMNS = ("element size [px]", "l_c [px]", "residual [grey levels]", "gap [1/px]", "degrees of freedom",
           "noise at nodes [px]", "predicted error [px]", "virtual error [px]")
"""Of the table that is printed."""

_FIELDS = ("element_size_px", "cut_off_wavelength_px", "residual_grey_levels", "gap_per_px", "degrees_of_freedom",
           "noise_at_nodes_px", "predicted_error_px", "virtual_error_px", "recommended", "failure")


def format_rows(sweep: Sweep) -> list[tuple[str, ...]]:
    """Format the rows of the table that is printed, by element size and wavelength.

    Parameters
    ----------
    sweep : Sweep
        What was found.

    Returns
    -------
    list of tuple of str
        A text for each of COLUMNS.
    """
    rows = []
    for trial in _sort(sweep):
        cells = _format_cells(trial)
        if trial.failure:
            cells[-1] = "not measured"
        elif trial is sweep.best:
            cells[-1] += " <"
        rows.append(tuple(cells))
    return rows


def list_failures(sweep: Sweep) -> list[str]:
    """List why some candidates have no error.

    Parameters
    ----------
    sweep : Sweep
        What was found.

    Returns
    -------
    list of str
        A line for each of them.
    """
    return [f"not measured: {trial.candidate.describe()}: {trial.short_failure}"
            for trial in _sort(sweep) if trial.failure]


def write_sweep(sweep: Sweep, path: Path, files: NewFiles | None = None) -> None:
    """Write a row for each trial as comma-separated values.

    Parameters
    ----------
    sweep : Sweep
        What was found.
    path : Path
        The file.
    files : NewFiles, optional
        With which it takes its name; by default it does so by itself.

    Raises
    ------
    OSError
        Where it cannot be written; no half-written file stays.
    """
    with begin_files(files) as new, new.begin(path).open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(_FIELDS)
        for trial in _sort(sweep):
            table.writerow([*_format_cells(trial), int(trial is sweep.best), trial.failure])


def collect_by_size(sweep: Sweep) -> list[SweptElements]:
    """Group trials by element size, as curves are drawn.

    Parameters
    ----------
    sweep : Sweep
        What was found.

    Returns
    -------
    list of SweptElements
        By size.
    """
    trials = _sort(sweep)
    groups = []
    for size in dict.fromkeys(trial.candidate.element_size for trial in trials):
        members = [trial for trial in trials if trial.candidate.element_size == size]
        recommended = next((k for k, trial in enumerate(members) if trial is sweep.best), None)
        groups.append(SweptElements("of the mesh file" if size is None else f"{size:g} px",
                                    np.array([trial.candidate.wavelength for trial in members]),
                                    _collect(members, "residual"), _collect(members, "gap"),
                                    _collect(members, "predicted_error"), _collect(members, "virtual_error"),
                                    recommended))
    return groups


def _collect(trials: list[Trial], name: str) -> NDArray[np.float64]:
    return np.array([getattr(trial, name) for trial in trials], dtype=np.float64)


def _sort(sweep: Sweep) -> list[Trial]:
    return sorted(sweep.trials, key=lambda trial: (trial.candidate.element_size or 0.0, trial.candidate.wavelength))


def _format_cells(trial: Trial) -> list[str]:
    size, length = trial.candidate.element_size, trial.candidate.wavelength
    numbers = (trial.noise, trial.predicted_error, trial.virtual_error)
    return ["mesh file" if size is None else f"{size:g}", f"{length:g}" if length else "none",
            f"{trial.residual:.4g}", f"{trial.gap:.2e}", f"{trial.degrees_of_freedom:.0f}",
            *(f"{number:.2e}" for number in numbers)]

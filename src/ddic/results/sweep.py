"""What a sweep over cut-off wavelengths and element sizes found, which of them it recommends, and its tables."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ddic.arrays import Array
from ddic.errors import ConvergenceError
from ddic.io.replace_on_exit import NewFiles, begin_files
from ddic.plots.curves import SweptElements

NO_WORSE = 1.02
"""Error over the least one up to which larger elements and a longer cut-off wavelength are preferred. A larger value
smooths more."""

IN_DOUBT = 1.25
"""The same, as the residual predicts the errors, from which on the recommendation is called doubtful."""


@dataclass(frozen=True)
class Candidate:
    """An element size and a cut-off wavelength.

    Attributes
    ----------
    element_size : float or None
        Pixels; None where the case's own elements stay.
    cut_off_wavelength : float
        l_c, pixels; 0 without regularization.
    """

    element_size: float | None
    cut_off_wavelength: float

    def describe(self) -> str:
        """Return what it is, for messages and tables."""
        gap = f"l_c = {self.cut_off_wavelength:g} px" if self.cut_off_wavelength else "no regularization"
        return gap if self.element_size is None else f"elements of {self.element_size:g} px, {gap}"


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate and how it measured the pair and the virtual images.

    Attributes
    ----------
    candidate : Candidate
        What was tried.
    displacement : (n_points, 2) array
        Measured of the pair at the points of the sweep, pixels; nan where nothing was measured.
    residual : float
        RMS over the pixels that count, grey levels.
    n_pixels : int
        Their number.
    gap : float
        RMS of the forces that are out of equilibrium at interior nodes, over Young's modulus, 1/px.
    degrees_of_freedom : float
        tr(A^-1 M) and what the correction of grey levels takes, no unit.
    noise : float
        RMS of a component at nodes that camera noise is expected to leave, pixels.
    predicted_error : float
        RMS error of a component that the residual predicts, pixels; nan before it is known.
    virtual_error : float
        RMS error of a component on the virtual images, pixels; nan where they were not measured.
    failure : str
        Why there is no measurement; empty where there is one.
    """

    candidate: Candidate
    displacement: Array
    residual: float = np.nan
    n_pixels: int = 0
    gap: float = np.nan
    degrees_of_freedom: float = np.nan
    noise: float = np.nan
    predicted_error: float = np.nan
    virtual_error: float = np.nan
    failure: str = ""


@dataclass(frozen=True, eq=False)
class Sweep:
    """All trials of a sweep and the recommendation.

    Attributes
    ----------
    trials : tuple of Trial
        In the order in which they were measured; the case's own settings first.
    points : (n_points, 2) array
        Where errors are taken, pixels.
    camera_noise : float
        Standard deviation of one image's noise, estimated from the residual, grey levels.
    truth : int
        Number of the trial whose roughened field the virtual images have.
    recommended : int
        Number of the trial that is recommended.
    """

    trials: tuple[Trial, ...]
    points: Array
    camera_noise: float
    truth: int
    recommended: int

    @property
    def best(self) -> Trial:
        """The trial that is recommended."""
        return self.trials[self.recommended]

    def describe_recommendation(self) -> str:
        """Return what is recommended and why, in one line."""
        best, own = self.best, self.trials[0]
        n_measured = sum(bool(np.isfinite(trial.virtual_error)) for trial in self.trials)
        reason = (f"error of {best.virtual_error:.2g} px RMS on the virtual images, within "
                  f"{100 * (NO_WORSE - 1):.0f} % of the least of {n_measured} settings")
        if best is not own and np.isfinite(own.virtual_error):
            reason += f"; the case's own settings: {own.virtual_error:.2g} px"
        notes = [*self._note_ends(), *self._note_doubt()]
        return "; ".join([f"recommended: {best.candidate.describe()}: {reason}", *notes])

    def describe_case(self) -> str:
        """Return what to write into the case file: sections and keys."""
        best = self.best.candidate
        lines = [] if best.element_size is None else ["[mesh.structured]", f"element_size = {best.element_size:g}"]
        gap = ["[regularization]", f"cut_off_wavelength = {best.cut_off_wavelength:g}"]
        return "\n".join([*lines, *(gap if best.cut_off_wavelength else ["# without [regularization]"])])

    def _note_ends(self) -> list[str]:
        """What lies beyond the sweep on the side of its best."""
        best = self.best.candidate
        measured = [trial.candidate for trial in self.trials if np.isfinite(trial.virtual_error)]
        notes = []
        sizes = {candidate.element_size for candidate in measured if candidate.element_size is not None}
        if best.element_size is not None and len(sizes) > 1 and best.element_size in (min(sizes), max(sizes)):
            side = "smaller" if best.element_size == min(sizes) else "larger"
            notes.append(f"no {side} elements were tried")
        lengths = {candidate.cut_off_wavelength for candidate in measured}
        if len(lengths) > 1 and best.cut_off_wavelength == max(lengths):
            notes.append("no longer l_c was tried")
        return notes

    def _note_doubt(self) -> list[str]:
        """Whether the residual of the pair itself would choose otherwise."""
        predicted = np.array([trial.predicted_error for trial in self.trials])
        if not np.isfinite(predicted).any():
            return []
        least = int(np.nanargmin(predicted))
        if not self.best.predicted_error > IN_DOUBT * predicted[least]:
            return []
        return [f"in doubt: the residual of the pair predicts {self.best.predicted_error:.2g} px here and "
                f"{predicted[least]:.2g} px with {self.trials[least].candidate.describe()}"]


@dataclass(frozen=True)
class PairNoise:
    """Noise of an image pair, as the finest fields leave it.

    Attributes
    ----------
    variance : float
        Of the residual, for each pixel that no unknown follows, grey levels squared.
    transfer : float
        Share of the deformed image's variance that interpolation leaves (``average_noise_transfer``).
    """

    variance: float
    transfer: float

    @property
    def camera(self) -> float:
        """Standard deviation of one image's noise, grey levels."""
        return float(np.sqrt(self.variance / (1.0 + self.transfer)))

    @property
    def of_field(self) -> float:
        """Variance of both images, which reaches the field, grey levels squared."""
        # Interpolation takes the finest part of the deformed image's, which speckle does not feel.
        return 2.0 * self.camera**2


def estimate_pair_noise(trials: Sequence[Trial], transfer: float) -> PairNoise:
    """Estimate the noise of a pair: the least residual, each unknown having followed as much as one pixel's.

    Trials that failed do not count. ``transfer`` is what interpolation leaves of the variance of noise.
    """
    variances = [trial.residual**2 * trial.n_pixels / max(trial.n_pixels - trial.degrees_of_freedom, 1.0)
                 for trial in trials if not trial.failure]
    return PairNoise(min(variances), transfer)


def predict_errors(trials: Sequence[Trial], noise: PairNoise, mean_square_gradient: float) -> list[Trial]:
    """Predict the error of each field by Stein's unbiased estimate: residual and degrees of freedom.

    The residual of a field grows by what it lacks of the displacement and shrinks by the noise that it follows, 2
    sigma^2 tr(A^-1 M) more than the error does. Relative to the field of most degrees of freedom, whose error is taken
    to be noise alone, what all residuals have in common falls out (interpolation, rounding).

    ``mean_square_gradient`` is that of the reference image, both components together, grey levels squared per square
    pixel. Predicted errors are RMS of a component, pixels, weighted by the texture. Where noise makes the square
    negative, so is its root: the order remains.
    """
    finest = max((trial for trial in trials if not trial.failure), key=lambda trial: trial.degrees_of_freedom)
    predicted = []
    for trial in trials:
        if trial.failure:
            predicted.append(trial)
            continue
        n = trial.n_pixels
        # Of as many pixels, where one excludes more than the other.
        excess = n * (trial.residual**2 - finest.residual**2)
        followed = noise.of_field * (2.0 * trial.degrees_of_freedom - finest.degrees_of_freedom)
        square = (excess + followed) / (n * mean_square_gradient)
        predicted.append(replace(trial, predicted_error=_root(square)))
    return predicted


def correct_predictions(trials: Sequence[Trial], known: int) -> list[Trial]:
    """Shift all squares of predicted errors alike, so that one trial's is its error on the virtual images.

    The residual tells apart errors of a few per cent of the noisiest field's; how large all of them are together it
    tells no better than the texture is even. ``known`` is the number of the trial whose field the virtual images have;
    nothing is shifted where that trial has no error on them.
    """
    anchor = trials[known]
    if not np.isfinite(anchor.virtual_error):
        return list(trials)
    offset = anchor.virtual_error**2 - _square(anchor.predicted_error)
    return [replace(trial, predicted_error=_root(_square(trial.predicted_error) + offset)) for trial in trials]


def _square(error: float) -> float:
    return float(np.sign(error)) * error**2


def _root(square: float) -> float:
    return float(np.sign(square) * np.sqrt(abs(square)))


def choose_trial(trials: Sequence[Trial]) -> int:
    """Choose the largest elements, then the longest wavelength, whose error is next to the least.

    Returns the trial's number. Raises ConvergenceError where no trial has an error on the virtual images.
    """
    errors = np.array([trial.virtual_error for trial in trials])
    if not np.isfinite(errors).any():
        raise ConvergenceError("no setting of the sweep measures the virtual images; give longer --lengths or larger "
                               "--elements")
    near = np.flatnonzero(errors <= NO_WORSE * np.nanmin(errors))
    return int(max(near, key=lambda k: _order(trials[k])))


COLUMNS = ("element size [px]", "l_c [px]", "residual [grey levels]", "gap [1/px]", "degrees of freedom",
           "noise at nodes [px]", "predicted error [px]", "virtual error [px]")
"""Of the table that is printed."""

_FIELDS = ("element_size_px", "cut_off_wavelength_px", "residual_grey_levels", "gap_per_px", "degrees_of_freedom",
           "noise_at_nodes_px", "predicted_error_px", "virtual_error_px", "recommended", "failure")


def format_rows(sweep: Sweep) -> list[tuple[str, ...]]:
    """Format the rows of the table that is printed, by element size and wavelength: a text for each of COLUMNS."""
    rows = []
    for trial in _sort(sweep):
        cells = _format_cells(trial)
        if trial.failure:
            cells[-1] = "not measured"
        elif trial is sweep.best:
            cells[-1] += " <"
        rows.append(tuple(cells))
    return rows


CLAUSE_END = r" \(|[;:\n]"


def list_failures(sweep: Sweep) -> list[str]:
    """List why some candidates have no error, a line for each of them: the first clause of its failure."""
    return [f"not measured: {trial.candidate.describe()}: {re.split(CLAUSE_END, trial.failure, maxsplit=1)[0]}"
            for trial in _sort(sweep) if trial.failure]


def write_sweep(sweep: Sweep, path: Path, files: NewFiles | None = None) -> None:
    """Write a row for each trial as comma-separated values.

    The file takes its name with ``files``, by default by itself. Raises OSError where it cannot be written; no
    half-written file stays.
    """
    with begin_files(files) as new, new.begin(path).open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(_FIELDS)
        for trial in _sort(sweep):
            table.writerow([*_format_cells(trial), int(trial is sweep.best), trial.failure])


def collect_by_size(sweep: Sweep) -> list[SweptElements]:
    """Group trials by element size, as curves are drawn."""
    trials = _sort(sweep)
    groups = []
    for size in dict.fromkeys(trial.candidate.element_size for trial in trials):
        members = [trial for trial in trials if trial.candidate.element_size == size]
        recommended = next((k for k, trial in enumerate(members) if trial is sweep.best), None)
        wavelengths = np.array([trial.candidate.cut_off_wavelength for trial in members])
        found = [(trial.residual, trial.gap, trial.predicted_error, trial.virtual_error) for trial in members]
        residuals, gaps, predicted, virtual = np.array(found).T
        label = "of the mesh file" if size is None else f"{size:g} px"
        groups.append(SweptElements(label, wavelengths, residuals, gaps, predicted, virtual, recommended))
    return groups


def _sort(sweep: Sweep) -> list[Trial]:
    return sorted(sweep.trials, key=_order)


def _order(trial: Trial) -> tuple[float, float]:
    """By element size, then by cut-off wavelength."""
    return trial.candidate.element_size or 0.0, trial.candidate.cut_off_wavelength


def _format_cells(trial: Trial) -> list[str]:
    size, length = trial.candidate.element_size, trial.candidate.cut_off_wavelength
    numbers = (trial.noise, trial.predicted_error, trial.virtual_error)
    return ["mesh file" if size is None else f"{size:g}", f"{length:g}" if length else "none",
            f"{trial.residual:.4g}", f"{trial.gap:.2e}", f"{trial.degrees_of_freedom:.0f}",
            *(f"{number:.2e}" for number in numbers)]

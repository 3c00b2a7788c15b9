"""The JSON summary of a run, for scripts."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ddic.io.replace_on_exit import replaced_on_exit
from ddic.parallel.phases import Phase


@dataclass(frozen=True)
class NearSummary:
    """Measured motion of a near-field set-up and what its images say, with standard deviations.

    alpha_px: pixels of the far field; theta_rad: radians; residual_std_grey, noise_grey: of the near images.
    """

    alpha_px: tuple[float, float]
    alpha_std_px: tuple[float, float]
    theta_rad: float
    theta_std_rad: float
    residual_std_grey: float
    noise_grey: float


@dataclass(frozen=True)
class Summary:
    """What a run did and measured.

    iterations: of Gauss-Newton at full resolution; krylov_iterations: of each of them.
    residual_std_grey: grey levels; residual_percent_of_range: the same in % of the dynamic range.
    seconds: wall seconds by phase, the slowest rank's; cpu_seconds: by phase, all ranks'; imbalance: by phase, the
    busiest rank's CPU seconds over the ranks' mean, without those spent waiting for other ranks outside PETSc;
    peak_memory_bytes: by rank. eta, cut_off_wavelength (px): None without regularization.
    largest_jump_px: largest displacement jump left at an interface node; linear_error_px: estimated RMS error of
    the displacement that the last linear step left (0 if direct, None if unknown).
    n_pixels: correlated; n_pixels_outside: left out because they are mapped outside the deformed image or
    onto its excluded pixels. notes: how the start was found, and warnings.
    grey_correction: what was corrected. result_file: name of the result file. near: near-field set-ups in order; the
    residual is then that of the far images.
    """

    converged: bool
    iterations: int
    residual_std_grey: float
    residual_percent_of_range: float
    n_dofs: int
    n_subdomains: int
    n_ranks: int
    krylov_iterations: Sequence[int]
    seconds: Mapping[Phase, float]
    cpu_seconds: Mapping[Phase, float]
    peak_memory_bytes: Sequence[int]
    largest_jump_px: float
    linear_error_px: float
    n_pixels: int
    n_pixels_outside: int
    grey_correction: str
    result_file: str
    eta: float | None = None
    cut_off_wavelength: float | None = None
    notes: Sequence[str] = field(default_factory=tuple)
    imbalance: Mapping[Phase, float] = field(default_factory=dict)
    near: Sequence[NearSummary] = field(default_factory=tuple)


def write_summary(path: Path, summary: Summary) -> None:
    """Write a summary as JSON (temporary name, then renamed); numbers that are not finite become null.

    Raises InputError if the folder cannot be written to.
    """
    text = json.dumps(_plain(asdict(summary)), indent=2, allow_nan=False)
    with replaced_on_exit(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value

"""The JSON summary, for scripts: what is told of a run, of a pair or a series, and of each frame; ranges of a field."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np

from ddic.arrays import Array
from ddic.functionals.regularization import HalfAmplitudes
from ddic.io.replace_on_exit import NewFiles
from ddic.io.result_schema import AXES, DISTRUST, LOOK, TRUST, Verdict, list_components
from ddic.io.text_files import convert_to_json, write_json
from ddic.kinematics.strain import compute_strain
from ddic.mesh.mesh import Mesh, join_meshes
from ddic.parallel.phases import Phase
from ddic.parallel.team import Team


@dataclass(frozen=True)
class NearSummary:
    """Measured motion of a near-field set-up and what its images say.

    Attributes
    ----------
    alpha_px, alpha_std_px : (x, y)
        Translation and its standard deviation, far-field pixels.
    theta_rad, theta_std_rad : float
        Rotation and its standard deviation, radians.
    residual_std_grey, noise_grey : float
        Standard deviation of the near images' residual and of their noise, grey levels.
    """

    alpha_px: tuple[float, float]
    alpha_std_px: tuple[float, float]
    theta_rad: float
    theta_std_rad: float
    residual_std_grey: float
    noise_grey: float


@dataclass(frozen=True)
class FieldRanges:
    """Least and largest values of a field.

    Attributes
    ----------
    displacement_px : dict of (least, largest)
        Of the nodes, by component: x, y, perhaps z; pixels.
    strain : dict of (least, largest)
        Infinitesimal, at the cells' centres, by component: xx, yy, xy, or all six in space; no unit.
    """

    displacement_px: Mapping[str, tuple[float, float]]
    strain: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Summary:
    """What a run did and measured.

    Attributes
    ----------
    converged : bool
        Whether the measurement did.
    iterations, local_iterations : int
        Of Gauss-Newton: at full resolution, each a pass over all pixels; with the pixels about slow nodes alone.
    residual_std_grey, residual_percent_of_range : float
        Standard deviation of the residual of the first camera's images, grey levels; in percent of the dynamic range.
    n_dofs, n_subdomains, n_ranks : int
        Unknowns of the whole problem, subdomains, MPI ranks.
    krylov_iterations : sequence of int
        Of each iteration of Gauss-Newton.
    seconds, cpu_seconds : dict
        By phase: wall seconds, the slowest rank's; CPU seconds, all ranks'.
    peak_memory_bytes : sequence of int
        By rank.
    largest_jump_px : float
        Largest displacement jump left at an interface node, pixels.
    linear_error_px : float
        Estimated RMS error of the displacement that the last linear step left, pixels; 0 for a direct solver, nan if
        unknown.
    n_pixels, n_pixels_outside : int
        Correlated pixels; those left out because they are mapped outside the deformed image or onto its excluded
        pixels.
    grey_correction : str
        What was corrected of grey levels.
    result_file : str
        Name of the result file.
    eta : float or None
        Weight of the equilibrium gap, grey levels squared per pixel squared; None without regularization.
    cut_off_wavelength : float or None
        Pixels; None without regularization.
    notes : sequence of str
        How the start was found, and warnings.
    imbalance : dict
        By phase the busiest rank's CPU seconds over the ranks' mean, without those spent waiting for other ranks
        outside PETSc.
    near : sequence of NearSummary
        Near-field set-ups in order.
    stop, failure : str
        Which tolerances ended Gauss-Newton; why it did not converge, empty where it did.
    half_amplitudes : HalfAmplitudes or None
        Waves that the cut-off wavelength halves, pixels; None without one.
    n_modes : int or None
        Products that the displacement of PGD-DIC is a sum of; None for other methods. Its iterations are corrections.
    noise_floor_px : float
        RMS displacement error of a component of a node that noise of the residual's size leaves, pixels; nan where it
        is not estimated.
    ranges : FieldRanges or None
        Of displacement and strain.
    iteration_table : dict of sequence
        Columns of the table of iterations, or of PGD-DIC's corrections, as the result file has them.
    images : dict of str
        Paths of the images: reference, deformed, near_1_reference, near_1_deformed, ...
    method : str
        How the linear steps were solved, as a case calls it, or PGD-DIC; what the case asked for is in ``case``.
    preconditioner : str
        Of the interface problem; "none" where there is none.
    case : dict
        The validated case with all defaults, as the result file has it, and the path of its file as ``path``.
    verdict : Verdict
        Whether the field can be trusted, and why not.
    comparison, identification : dict
        Columns of the table of a comparison with a simulation, a row a region, and of that of a material's parameters;
        empty where there is none.
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
    stop: str = ""
    half_amplitudes: HalfAmplitudes | None = None
    n_modes: int | None = None
    failure: str = ""
    noise_floor_px: float = float("nan")
    ranges: FieldRanges | None = None
    iteration_table: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    images: Mapping[str, str] = field(default_factory=dict)
    method: str = ""
    preconditioner: str = "none"
    case: Mapping[str, Any] = field(default_factory=dict)
    local_iterations: int = 0
    verdict: Verdict | None = None
    comparison: Mapping[str, Any] = field(default_factory=dict)
    identification: Mapping[str, Any] = field(default_factory=dict)


def write_summary(path: Path, summary: Summary, files: NewFiles | None = None) -> None:
    """Write a summary as ``write_json`` does."""
    write_json(path, asdict(summary), files)


def find_field_ranges(team: Team, fields: Sequence[tuple[Mesh, Array]]) -> FieldRanges:
    """Find the least and largest displacement of nodes and strain of cells, the same on all ranks; collective.

    Fields are meshes that this rank owns and the displacement of their nodes, (n_dofs,), node by node, pixels; nan
    where it was not measured. Ranges are those of what was measured, nan where nothing was.
    """
    meshes, displacements = zip(*fields, strict=True)
    limits = team.gather_lists([_find_limits(join_meshes(meshes), np.concatenate(displacements))])
    # fmin and fmax take the number of a number and nan.
    least = np.fmin.reduce([low for low, _ in limits], axis=0).tolist()
    largest = np.fmax.reduce([high for _, high in limits], axis=0).tolist()
    by_component, dim = list(zip(least, largest, strict=True)), meshes[0].dim
    return FieldRanges(dict(zip(AXES[:dim], by_component[:dim], strict=True)),
                       dict(zip(list_components(dim), by_component[dim:], strict=True)))


def _find_limits(mesh: Mesh, u: Array) -> tuple[Array, Array]:
    """Least and largest of the displacement's components, then of the strain's; nan where nothing was measured."""
    displacement, strain = u.reshape(-1, mesh.dim), compute_strain(mesh, u).infinitesimal
    return (np.concatenate([np.fmin.reduce(displacement, axis=0), np.fmin.reduce(strain, axis=0)]),
            np.concatenate([np.fmax.reduce(displacement, axis=0), np.fmax.reduce(strain, axis=0)]))


Vertices = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class FrameRecord:
    """One frame of a series.

    Attributes
    ----------
    number : int
        From 1.
    image : str
        The far camera's deformed image.
    time : float
        Unit chosen by the user.
    converged : bool
        Whether it was measured.
    iterations : int
        Of Gauss-Newton.
    residual_std_grey : float
        Standard deviation of the residual, grey levels.
    noise_floor_px : float
        RMS displacement that noise of the residual's size leaves, pixels; nan where it is not estimated.
    seconds : float
        Wall time, the slowest rank's.
    started_from : str
        Where Gauss-Newton started.
    reference : int
        Frame whose image was the reference image; 0 for the first one.
    failure : str
        Why it was not measured; empty where it was.
    notes : sequence of str
        What the user should know.
    lines : tuple of tuple of (x, y)
        Vertices of the discontinuities that it was measured with where the residual of this frame or an earlier one has
        refined them, pixels; empty where they are those of the case.
    verdict : str
        Whether its field can be trusted, a word of ``Verdict``; empty where it was not measured.
    reasons : sequence of str
        Why not, where, and what to do about it.
    """

    number: int
    image: str
    time: float
    converged: bool
    iterations: int = 0
    residual_std_grey: float = float("nan")
    noise_floor_px: float = float("nan")
    seconds: float = float("nan")
    started_from: str = ""
    reference: int = 0
    failure: str = ""
    notes: Sequence[str] = field(default_factory=tuple)
    lines: tuple[Vertices, ...] = ()
    verdict: str = ""
    reasons: Sequence[str] = field(default_factory=tuple)

    def as_json(self) -> str:
        """Write it as a line of JSON, with null for what is not finite."""
        return json.dumps(convert_to_json(asdict(self)), allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Read back what ``as_json`` wrote."""
        values: dict[str, Any] = json.loads(text)
        finite: dict[str, Any] = {name: float("nan") if value is None else value for name, value in values.items()}
        finite["lines"] = tuple(tuple((x, y) for x, y in line) for line in values.get("lines", ()))
        return cls(**finite)

    def describe(self) -> str:
        """Say in a line of the log what became of the frame."""
        if not self.converged:
            return f"frame {self.number}: not measured ({self.failure})"
        compared = f", compared with frame {self.reference}" if self.reference else ""
        judged = "" if self.verdict == TRUST else f"; {Verdict(self.verdict, tuple(self.reasons)).describe()}"
        return (f"frame {self.number}: {self.iterations} iterations from {self.started_from}{compared}, residual "
                f"{self.residual_std_grey:.3f} grey levels, {self.seconds:.2f} s{judged}")


@dataclass(frozen=True)
class SeriesSummary:
    """What a series came to.

    Attributes
    ----------
    frames : sequence of FrameRecord
        Those that are finished, in order.
    n_frames : int
        Those that were asked for.
    result_file : str
        Name of the result file; of its folder of frames where it is not whole.
    seconds : float
        Wall time of this run.
    n_resumed : int
        Frames that an earlier run had finished.
    case : dict
        Path and text of the case file.
    """

    frames: Sequence[FrameRecord]
    n_frames: int
    result_file: str
    seconds: float
    n_resumed: int = 0
    case: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_whole(self) -> bool:
        """Whether every frame was tried."""
        return len(self.frames) == self.n_frames

    @property
    def failures(self) -> list[FrameRecord]:
        """The frames that could not be measured."""
        return [frame for frame in self.frames if not frame.converged]

    def describe_verdicts(self) -> str:
        """Say in a line which frames can be trusted."""
        measured = [frame for frame in self.frames if frame.converged]
        n_trusted = sum(frame.verdict == TRUST for frame in measured)
        told = [f"trust {n_trusted} of {len(measured)} frames"]
        for word, what in ((LOOK, "look at"), (DISTRUST, "do not trust")):
            numbers = [str(frame.number) for frame in measured if frame.verdict == word]
            if numbers:
                told.append(f"{what} {', '.join(numbers)}")
        return "; ".join(told)


def write_series_summary(path: Path, summary: SeriesSummary, files: NewFiles | None = None) -> None:
    """Write a summary of a series as ``write_json`` does."""
    of_run = asdict(summary)
    frames = of_run.pop("frames")
    write_json(path, {"converged": summary.is_whole and not summary.failures, "whole": summary.is_whole, **of_run,
                      "frames": frames}, files)

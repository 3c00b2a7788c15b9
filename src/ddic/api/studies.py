"""What is asked of a case beyond its field: a cut-off wavelength and an element size, chosen by trying them out.

What displacements of one's own speckle are measured with, by size of the elements, without and with a line. Parameters
of a model of one's own.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ddic.api.given import load_given_case, make_case, sort_arguments
from ddic.api.measure import measure
from ddic.arrays import Array, IntArray
from ddic.case.loader import LoadedCase
from ddic.case.methods import find_method_section
from ddic.case.named_files import list_deformed
from ddic.case.schema import Case, DiscontinuitySection, SolverSection
from ddic.errors import ConvergenceError, InputError, SingularSubdomainError, refuse_unknown_arguments
from ddic.identification.joint_step import FunctionModel
from ddic.images.binned import ArraySource
from ddic.images.sub_image import MaskedSource
from ddic.inputs.cameras import make_first_camera
from ddic.inputs.inputs import Inputs, open_inputs
from ddic.inputs.mesh_source import LONGEST_WAVELENGTH, SHORTEST_WAVELENGTH, build_meshes
from ddic.io.result_reader import Result, read_result
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import multiply_across
from ddic.mesh.quality import measure_cell_size
from ddic.mesh.structured import build_structured_mesh
from ddic.methods.fe_dic import find_discontinuities, is_line_wanted
from ddic.methods.material import identify_case
from ddic.methods.sweep import list_element_sizes, list_wavelengths, measure_candidates, set_resolution
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team, require_held
from ddic.problem.reference_problem import build_whole_mesh, prepare_reference
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.listener import Silence
from ddic.results.sweep import Candidate, Sweep
from ddic.solvers.local_system import MonolithicStep
from ddic.solvers.probing import estimate_noise_rms

Simulate = Callable[[Mesh, Array], Array | tuple[Array, Array]]
"""A model: from a mesh and parameters to displacements of nodes, or to these and their derivatives."""

N_FRAMES = 3
"""Images that each candidate measures: the case's, and the virtual ones."""


def choose_regularization(case: str | Path | Case | LoadedCase, *,
                          cut_off_wavelengths: Sequence[float] | None = None,
                          element_sizes: Sequence[float] | None = None,
                          advance: Callable[[str, int], None] | None = None) -> Sweep:
    """Try cut-off wavelengths and element sizes on a pair and on virtual images made from it; collective.

    Parameters
    ----------
    case : str, Path, Case or LoadedCase
        Of one camera; of a series the last image is taken.
    cut_off_wavelengths : sequence of float, optional
        l_c, pixels, 0 for no regularization; by default none and nine about the case's own, sqrt 2 apart.
    element_sizes : sequence of float, optional
        Of a structured mesh, pixels; by default five about the case's own, sqrt 2 apart. A mesh from a file keeps its
        elements.
    advance : callable, optional
        Told on every rank what is measured next, and how many measurements there are.

    Returns
    -------
    Sweep
        All that was tried, and which of it is recommended; the same on all ranks.

    Raises
    ------
    InputError, ConvergenceError
        On all ranks: where the case cannot be swept, and where nothing that is tried measures it.
    """
    team = Team.world()
    loaded = team.on_root(lambda: load_given_case(case, Path("case"), team.size))
    # Of a series the last image, which has moved most.
    inputs, frame = open_inputs(team, loaded, len(list_deformed(loaded.case.imaging)) - 1)
    team.together(lambda: _refuse_impossible(inputs.case, cut_off_wavelengths, element_sizes))
    if is_line_wanted(inputs.case):
        inputs, _ = find_discontinuities(team, inputs, frame, Silence(), PhaseClock(waiting=team.waiting))
    candidates = team.on_root(lambda: _list_candidates(inputs, cut_off_wavelengths, element_sizes))
    varied = [(candidate, _vary(inputs, candidate)) for candidate in candidates]
    told = advance or (lambda what, count: None)
    return measure_candidates(team, varied, frame, lambda what: told(what, 2 * len(varied)))


def _refuse_impossible(case: Case, wavelengths: Sequence[float] | None, sizes: Sequence[float] | None) -> None:
    """Refuse cases of other methods, and sizes that are none."""
    section = find_method_section(case)
    if section is not None:
        raise InputError(f"[{section}]: a sweep measures finite elements; leave [{section}] out")
    if case.near:
        raise InputError("[[near]]: a sweep knows one camera; leave [[near]] out")
    if case.regularization is not None and case.regularization.yield_strain is not None:
        raise InputError("regularization.yield_strain: a sweep has no history; leave yield_strain out")
    if sizes is not None and case.mesh.structured is None:
        raise InputError("element sizes: they go with [mesh.structured]; other elements stay as they are, leave "
                         "the sizes out")
    for name, values, least in (("cut-off wavelengths", wavelengths, 0.0), ("element sizes", sizes, 1.0)):
        if values is not None and not (len(values) and all(least <= value < float("inf") for value in values)):
            raise InputError(f"{name} {list(values)}: give numbers of pixels, at least {least:g}")


def _list_candidates(inputs: Inputs, wavelengths: Sequence[float] | None,
                     sizes: Sequence[float] | None) -> list[Candidate]:
    """All pairs whose elements carry the wavelength, the case's own first where it is among them."""
    case = inputs.case
    mesh = inputs.build_mesh()[0]
    typical = measure_cell_size(mesh)
    of_elements = list_element_sizes(case) if sizes is None else list(dict.fromkeys(sizes))
    lengths = list_wavelengths(case, typical) if wavelengths is None else list(dict.fromkeys(wavelengths))
    pairs = [Candidate(size, length) for size in of_elements for length in lengths
             if length == 0 or SHORTEST_WAVELENGTH <= length / (size or typical) <= LONGEST_WAVELENGTH]
    if not pairs:
        raise InputError(f"cut-off wavelengths {lengths}: shorter than {SHORTEST_WAVELENGTH:g} elements, all of them; "
                         "give longer ones")
    section, structured = case.regularization, case.mesh.structured
    own = Candidate(None if structured is None else structured.element_size,
                    0.0 if section is None else section.cut_off_wavelength or 0.0)
    return sorted(pairs, key=lambda candidate: candidate != own)


def _vary(inputs: Inputs, candidate: Candidate) -> Inputs:
    """The inputs with a candidate's case and mesh."""
    case = set_resolution(inputs.case, candidate.element_size, candidate.cut_off_wavelength)
    image: Any = inputs.cameras[0].reference.image
    return replace(inputs, case=case, n_frames=N_FRAMES, build_mesh=lambda: build_meshes(case, image.extent))


Kind = Literal["uniform", "discontinuous"]
KINDS: tuple[Kind, Kind] = ("uniform", "discontinuous")
"""All moves by d along x and y; the sides of a line move apart by d along it, or across it where it can only open."""

BASES = ("continuous", "enriched")

ANGLE = np.deg2rad(27.0)
"""Of the line, where none is given: it runs along no axis of the elements."""

MARGIN = 12
"""Pixels at the edge of the image that no element covers: displaced pixels and the spline's taps stay inside."""

LARGEST_SIDE = 1024
"""Pixels: of a larger image its middle is taken."""

DEGREE = 5
"""Of the spline that moves the image: another one than the cubic that measures, or its errors would cancel."""

OF_A_PAIR = ("images", "near", "mesh", "series", "start", "output")
"""Sections that say what is not chosen here."""

N_POINTS = 20000
"""Places at which errors are taken."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Errors of known displacements, by kind, element size, displacement and basis.

    Attributes
    ----------
    element_sizes : (n_sizes,) array
        Pixels.
    amplitudes : (n_amplitudes,) array
        Displacements and jumps, pixels.
    bias, deviation : dict of (n_sizes, n_amplitudes, 2) array
        By kind: mean and standard deviation of the error per component all over the region, pixels; continuous
        elements, then enriched ones; nan where a measurement did not converge.
    noise : float
        Standard deviation that was added to both images, grey levels.
    predicted_noise : (n_sizes, 2) array
        What that noise makes at nodes, 2 sigma^2 A^-1 M A^-1, RMS per component, pixels; nan where the operator is
        singular.
    """

    element_sizes: Array
    amplitudes: Array
    bias: dict[Kind, Array]
    deviation: dict[Kind, Array]
    noise: float
    predicted_noise: Array


def estimate_uncertainty(image: NDArray[Any], *, element_sizes: Sequence[float] = (8, 16, 32, 64),
                         n_amplitudes: int = 11, noise: float = 0.0, **sections: Any) -> Uncertainty:
    """Measure known displacements of an image, without and with a line that may open [RRH07], [RHR08].

    Parameters
    ----------
    image : (height, width) array
        One's own reference image, grey levels.
    element_sizes : sequence of float
        Of square elements, pixels.
    n_amplitudes : int
        Displacements from 0 to 1 px.
    noise : float
        Standard deviation of noise that is added to both images, grey levels.
    **sections
        Sections and keys of a case file, for every measurement; a regularization only with elements that carry its
        cut-off wavelength. Of ``discontinuity`` the first section counts: the straight line across the image through
        the ends of its vertices jumps, along it or, where its opening is "normal", across it. By default it runs
        through the middle at 27 degrees and may slide.

    Returns
    -------
    Uncertainty
        Of both kinds of displacement.

    Raises
    ------
    InputError
        Where the image is no array of grey levels, or too small for the elements; where noise is more than it shows.
    """
    grey = _take_middle(image)
    height, width = grey.shape
    middle = np.array([width, height]) / 2 + (0.37, -0.21)
    along = np.array([np.cos(ANGLE), np.sin(ANGLE)])
    ends = np.stack([middle - 2 * sum(grey.shape) * along, middle + 2 * sum(grey.shape) * along])
    of_elements = ("element_sizes", "n_amplitudes", "noise")
    refuse_unknown_arguments(sections, [*of_elements, *(name for name in Case.model_fields if name not in OF_A_PAIR)])
    settings = sort_arguments(sections).sections
    line = next(iter(make_case(settings).discontinuity), DiscontinuitySection(opening="tangential"))
    settings.pop("discontinuity", None)
    if line.vertices is not None:
        ends = _lengthen(np.array(line.vertices, dtype=np.float64)[[0, -1]] - _find_corner(image), sum(grey.shape))
    largest = min(grey.shape) - 2 * MARGIN
    if len(element_sizes) == 0 or not all(2 <= size <= largest for size in element_sizes):
        raise InputError(f"element_sizes: {list(element_sizes)} px on {width} x {height} px of the image; give sizes "
                         f"from 2 to {largest} px")
    span = float(np.ptp(grey))
    if not 0.0 <= noise <= span:
        raise InputError(f"noise: {noise:g}, but grey levels of the image span {span:g}; give a standard deviation in "
                         "grey levels")
    amplitudes = np.linspace(0.0, 1.0, n_amplitudes)
    shape = (len(element_sizes), n_amplitudes, len(BASES))
    bias: dict[Kind, Array] = {kind: np.full(shape, np.nan) for kind in KINDS}
    deviation: dict[Kind, Array] = {kind: np.full(shape, np.nan) for kind in KINDS}
    lines = [{"vertices": ends.tolist(), "opening": line.opening}]
    for kind in KINDS:
        for k, amplitude in enumerate(amplitudes):
            known = _Known(kind, float(amplitude), ends, is_normal=line.opening == "normal")
            pair = _add_noise(grey, known.deform(grey), noise, seed=k)
            for s, size in enumerate(element_sizes):
                for b, chosen in enumerate(_choose_settings(settings, lines, size)):
                    bias[kind][s, k, b], deviation[kind][s, k, b] = _measure_errors(pair, size, chosen, known)
    predicted = np.array([[_predict_noise(grey, size, chosen, noise)
                           for chosen in _choose_settings(settings, lines, size)] for size in element_sizes])
    return Uncertainty(np.array(element_sizes, dtype=np.float64), amplitudes, bias, deviation, noise, predicted)


@dataclass(frozen=True, eq=False)
class _Known:
    """A displacement: of everything along both axes, or of the sides of a line along it."""

    kind: Kind
    amplitude: float
    line: Array
    is_normal: bool

    def displacement(self, points: Array) -> Array:
        if self.kind == "uniform":
            return np.full(points.shape, self.amplitude)
        along = self.line[1] - self.line[0]
        half = np.where(multiply_across(along, points - self.line[0]) > 0, 0.5, -0.5)
        direction = np.array([-along[1], along[0]]) if self.is_normal else along
        return np.asarray(half[:, None] * self.amplitude * direction / np.linalg.norm(along))

    def deform(self, grey: Array) -> Array:
        """The deformed image: sides that slide stay where the line is; a gap shows what lies beside it."""
        y, x = np.mgrid[0:grey.shape[0], 0:grey.shape[1]].astype(float)
        points = np.column_stack([x.ravel(), y.ravel()])
        origins = points - self.displacement(points)
        moved = ndimage.map_coordinates(grey, origins[:, ::-1].T, order=DEGREE, mode="mirror")
        return np.asarray(moved.reshape(grey.shape))


def _take_middle(image: NDArray[Any]) -> Array:
    """Grey levels of at most LARGEST_SIDE pixels a side."""
    grey = np.asarray(image)
    if grey.ndim != 2 or not np.issubdtype(grey.dtype, np.number) or not np.isfinite(grey).all():
        raise InputError(f"image: an array of shape {grey.shape} and type {grey.dtype} is given; give grey levels "
                         "(height, width), all of them finite")
    x, y = _find_corner(grey)
    return grey[y:y + LARGEST_SIDE, x:x + LARGEST_SIDE].astype(np.float64)


def _find_corner(image: NDArray[Any]) -> IntArray:
    """Column and row of the first pixel of an image's middle."""
    height, width = image.shape
    return np.maximum(np.array([width, height]) - LARGEST_SIDE, 0) // 2


def _add_noise(reference: Array, deformed: Array, noise: float, seed: int) -> tuple[NDArray[Any], NDArray[Any]]:
    random = np.random.default_rng(seed)
    noisy = [image + noise * random.standard_normal(image.shape) for image in (reference, deformed)]
    return noisy[0].astype(np.float32), noisy[1].astype(np.float32)


def _choose_settings(settings: Mapping[str, Any], lines: Sequence[Any], size: float) -> tuple[dict[str, Any], ...]:
    """Settings of continuous and of enriched elements of a size."""
    chosen = dict(settings)
    wavelength = (settings.get("regularization") or {}).get("cut_off_wavelength")
    if wavelength is not None and wavelength < SHORTEST_WAVELENGTH * size:
        del chosen["regularization"]
    return chosen, {**chosen, "discontinuity": lines}


def _lengthen(ends: Array, length: float) -> Array:
    """The straight line through two points, far beyond both."""
    along = (ends[1] - ends[0]) / max(float(np.linalg.norm(ends[1] - ends[0])), 1e-12)
    return np.stack([ends[0] - 2 * length * along, ends[1] + 2 * length * along])


def _mesh_inside(shape: tuple[int, ...], size: float) -> Mesh:
    height, width = shape
    return build_structured_mesh((MARGIN, MARGIN, width - MARGIN, height - MARGIN), size)


def _predict_noise(grey: Array, size: float, settings: Mapping[str, Any], noise: float) -> float:
    """Displacement noise at nodes by the operator alone, pixels."""
    reference = MaskedSource(ArraySource(Path("image"), grey.astype(np.float32)))
    camera = make_first_camera(reference, None)
    inputs = Inputs(make_case(settings), (camera,), lambda: (_mesh_inside(grey.shape, size), None))
    try:
        return estimate_nodal_noise(inputs, noise)
    except SingularSubdomainError:
        return np.nan


def estimate_nodal_noise(inputs: Inputs, sigma: float) -> float:
    """Predict the noise of the displacement at nodes from the operator alone, on one rank.

    It has the covariance 2 sigma^2 A^-1 M A^-1, A = M + eta Kbar^T Kbar of the whole region. Phantom nodes, which lines
    add to the mesh, do not count.

    Parameters
    ----------
    inputs : Inputs
        Images of one camera, mesh and settings.
    sigma : float
        Standard deviation of the camera noise of both images, grey levels.

    Returns
    -------
    float
        RMS of a component, pixels.

    Raises
    ------
    InputError, SingularSubdomainError
        Where the problem cannot be set up.
    """
    team, clock = Team.alone(), PhaseClock()
    case = inputs.case.model_copy(update={"solver": SolverSection(method="monolithic")})
    inputs = replace(inputs, case=case)
    reference, _ = prepare_reference(team, inputs, build_whole_mesh(team, inputs), clock)
    problem = WeightedProblem(team, reference, clock)
    try:
        step, system = problem.solver.step, problem.solver.assembly.systems[0]
        assert isinstance(step, MonolithicStep)
        uncut, _ = inputs.build_mesh()
        counted = np.arange(reference.subdomains[0].mesh.n_dofs) < uncut.n_dofs
        return estimate_noise_rms(system, step.operator, sigma, counted)
    finally:
        problem.destroy()


def _measure_errors(pair: tuple[NDArray[Any], NDArray[Any]], size: float, settings: Mapping[str, Any],
                    known: _Known) -> tuple[float, float]:
    """Mean and standard deviation of the error, pixels; nan where nothing converges."""
    mesh = _mesh_inside(pair[0].shape, size)
    try:
        result = measure(pair, mesh, **settings)
    except (ConvergenceError, SingularSubdomainError):
        return np.nan, np.nan
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    points = np.random.default_rng(0).uniform(low, high, (N_POINTS, 2))
    error = result.at(points) - known.displacement(points)
    return float(np.nanmean(error)), float(np.nanstd(error, axis=0).mean())


def identify(case: str | Path, simulate: Simulate | None = None,
             start: Mapping[str, float] | None = None, *, step: float = 1e-3) -> Result:
    """Identify parameters from the images of a case, by its own law or by a model of one's own; collective.

    Parameters
    ----------
    case : str or Path
        The case file. Without ``simulate`` its section ``[identification]`` says the law.
    simulate : callable, optional
        From the mesh and the parameters, (n_parameters,), to the displacement of its nodes, pixels: (n_nodes, dim), or
        (n_frames, n_nodes, dim) of a series; or to that and its derivatives by each parameter, (n_parameters, n_nodes,
        dim), which differences give otherwise. Called on rank 0, also with a mesh of half the size. What acts on the
        specimen, displacements of its edges for instance, are among the parameters, or held by the function.
    start : mapping of float, optional
        Values from which its parameters are sought, by name, in their order.
    step : float, optional
        Of the differences by which it is differentiated, relative to a parameter, or to 1 where this is 0.

    Returns
    -------
    Result
        That of the last frame, as ``ddic identify`` writes it: ``identified`` has the parameters, their standard
        deviations and correlations.

    Raises
    ------
    InputError, ConvergenceError
        On all ranks: where the case or the start is wrong, and where the parameters are not found.
    """
    team = Team.world()
    # Rank 0's are used: others need not have them.
    given = team.on_root(lambda: _check_model(simulate, start, step))

    def build(case: Case, mesh: Mesh) -> FunctionModel:
        n_frames, values = len(list_deformed(case.imaging)), np.array(list(given.values()))

        def solve(parameters: Array) -> tuple[Array, Array | None]:
            found = require_held(simulate)(mesh, parameters)
            u, slopes = found if isinstance(found, tuple) else (found, None)
            of_frames = (n_frames, *mesh.nodes.shape)
            return (_require_shape(u, of_frames),
                    None if slopes is None else _require_shape(slopes, (len(values), *of_frames)))

        return FunctionModel(list(given), values, solve, step * np.where(values == 0.0, 1.0, np.abs(values)))

    summary = identify_case(team, Path(case), Silence(), build if given else None)
    return read_result(Path(summary.result_file))


def _require_shape(given: Array, shape: tuple[int, ...]) -> Array:
    """What a model gave, a copy: it may fill one place again and again. Raises InputError for another shape."""
    found, is_one_frame = np.array(given, np.float64), shape[-3] == 1
    without_frames = (*shape[:-3], *shape[-2:])
    if found.shape not in ((shape, without_frames) if is_one_frame else (shape,)) or not np.isfinite(found).all():
        raise InputError(f"ddic.identify: simulate gave an array of shape {found.shape}; {shape}, all finite, is "
                         "expected")
    return found.reshape(shape)


def _check_model(simulate: Simulate | None, start: Mapping[str, float] | None,
                 step: float) -> dict[str, float]:
    """The start of a model of one's own; empty without one. Raises InputError for what is none."""
    if (simulate is None) != (not start):
        raise InputError("ddic.identify: simulate and start go together: give both, or leave both out")
    given = dict(start or {})
    for name, value in given.items():
        if not isinstance(name, str) or not name.isidentifier():
            raise InputError(f"ddic.identify: start: {name!r} is no name; use letters, digits and _")
        if not isinstance(value, int | float) or not np.isfinite(value):
            raise InputError(f"ddic.identify: start: {name} = {value!r} is no finite number")
    if not 0.0 < step < 1.0:
        raise InputError(f"ddic.identify: step = {step!r}: it must be above 0 and below 1")
    return {name: float(value) for name, value in given.items()}

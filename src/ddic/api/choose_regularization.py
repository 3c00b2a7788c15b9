"""A cut-off wavelength and an element size for a case, chosen by trying them out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ddic.case.frame_files import list_deformed
from ddic.case.loader import LoadedCase
from ddic.case.resolution import list_element_sizes, list_wavelengths, set_resolution
from ddic.case.schema import Case
from ddic.check.case import check_loaded_case, load_checked_case
from ddic.errors import InputError
from ddic.inputs.inputs import Inputs, open_inputs
from ddic.inputs.mesh_source import LONGEST_WAVELENGTH, SHORTEST_WAVELENGTH, build_meshes
from ddic.io.input_file import as_path
from ddic.mesh.quality import measure_cell_size
from ddic.methods.detect import find_discontinuity
from ddic.methods.sweep_candidates import measure_candidates
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.results.sweep import Candidate, Sweep

N_FRAMES = 3
"""Images that each candidate measures: the case's, and the virtual ones."""


def choose_regularization(case: str | Path | Case | LoadedCase, *, wavelengths: Sequence[float] | None = None,
                          element_sizes: Sequence[float] | None = None,
                          advance: Callable[[str, int], None] | None = None) -> Sweep:
    """Try cut-off wavelengths and element sizes on a pair and on virtual images made from it; collective.

    Parameters
    ----------
    case : str, Path, Case or LoadedCase
        Of one camera; of a series the last image is taken.
    wavelengths : sequence of float, optional
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
    loaded = team.on_root(lambda: _load(case, team.size))
    # Of a series the last image, which has moved most.
    inputs, frame = open_inputs(team, loaded, len(list_deformed(loaded.case.images)) - 1)
    team.together(lambda: _refuse_impossible(inputs.case, wavelengths, element_sizes))
    inputs = find_discontinuity(team, inputs, frame, Silence(), PhaseClock(waiting=team.waiting))
    candidates = team.on_root(lambda: _list_candidates(inputs, wavelengths, element_sizes))
    varied = [(candidate, _vary(inputs, candidate)) for candidate in candidates]
    told = advance or (lambda what, count: None)
    return measure_candidates(team, varied, frame, lambda what: told(what, 2 * len(varied)))


def _load(source: str | Path | Case | LoadedCase, n_ranks: int) -> LoadedCase:
    if not isinstance(source, Case | LoadedCase):
        return load_checked_case(as_path(source, "case"), n_ranks)
    loaded = LoadedCase(source, Path("case"), "") if isinstance(source, Case) else source
    check_loaded_case(loaded, n_ranks)
    return loaded


def _refuse_impossible(case: Case, wavelengths: Sequence[float] | None, sizes: Sequence[float] | None) -> None:
    """Refuse cases of other methods, and sizes that are none."""
    if case.pgd is not None:
        raise InputError("[pgd]: a sweep measures finite elements; leave [pgd] out")
    if case.near:
        raise InputError("[[near]]: a sweep knows one camera; leave [[near]] out")
    if sizes is not None and case.mesh.structured is None:
        raise InputError("--elements: the mesh comes from a file, whose elements stay; give [mesh.structured], or "
                         "leave --elements out")
    for name, values, least in (("--lengths", wavelengths, 0.0), ("--elements", sizes, 1.0)):
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
        raise InputError(f"--lengths {lengths}: shorter than {SHORTEST_WAVELENGTH:g} elements, all of them; give "
                         "longer ones")
    own = _find_own(case)
    return sorted(pairs, key=lambda candidate: candidate != own)


def _find_own(case: Case) -> Candidate:
    """What the case itself says."""
    section, structured = case.regularization, case.mesh.structured
    length = 0.0 if section is None else section.cut_off_wavelength or 0.0
    return Candidate(None if structured is None else structured.element_size, length)


def _vary(inputs: Inputs, candidate: Candidate) -> Inputs:
    """The inputs with a candidate's case and mesh."""
    case = set_resolution(inputs.case, candidate.element_size, candidate.wavelength)
    image: Any = inputs.cameras[0].reference.image
    return replace(inputs, case=case, n_frames=N_FRAMES,
                   build_mesh=lambda: build_meshes(case, image.width, image.height))

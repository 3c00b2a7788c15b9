"""Keys of a case file that are right, but change nothing beside what else it says."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import BaseModel

from ddic.case.schema import Case

OF_DUAL = ("weighting", "preconditioner", "recycle", "local_inverse")
"""Keys of [solver] that only the interface problem asks."""

OF_KRYLOV = ("tolerance", "max_iterations", "inexact")
"""Keys of [solver] that only iterative linear steps ask."""

OF_PARTITION = ("subdomains", "partition", "blocks", "partition_file")
"""Keys of [solver] that say how the mesh is split."""


def list_unused_keys(case: Case) -> list[str]:
    """List the keys that a case gives and nothing asks for.

    Parameters
    ----------
    case : Case
        Validated.

    Returns
    -------
    list of str
        A line each: the key, what it goes with, what to do.
    """
    return [*_list_unused_solver_keys(case), *_list_unused_start_keys(case), *_list_other_unused_keys(case)]


def _list_unused_solver_keys(case: Case) -> Iterator[str]:
    method = case.solver.method
    if method == "auto":
        return
    yield from _describe(case.solver, "solver", ("frames",), 'solver.method = "auto"')
    if method != "dual":
        yield from _describe(case.solver, "solver", OF_DUAL, 'solver.method = "dual"')
    if method in ("assembled", "monolithic"):
        yield from _describe(case.solver, "solver", OF_KRYLOV, 'solver.method = "dual" or "conjugate_gradient"')
    if method == "monolithic":
        yield from _describe(case.solver, "solver", OF_PARTITION, "a method of several subdomains")


def _list_unused_start_keys(case: Case) -> Iterator[str]:
    start = case.start
    if start.from_result is not None:
        of_search = ("rigid", "features", "pyramid", "largest_enriched_block")
        yield from _describe(start, "start", of_search, "a start without start.from_result, which replaces it")
        return
    if not start.rigid and start.features:
        yield from _describe(start, "start", ("features",), "start.rigid = true, after which they are sought")
    if not case.discontinuity:
        yield from _describe(start, "start", ("largest_enriched_block",), "[[discontinuity]]")


def _list_other_unused_keys(case: Case) -> Iterator[str]:
    if case.solver.method not in ("auto", "dual") and case.start.independent:
        yield from _describe(case.start, "start", ("independent",), 'solver.method = "dual"')
    if not case.near:
        yield from _describe(case.images, "images", ("noise",), "[[near]], whose cameras it is weighed against")


def _describe(section: BaseModel, name: str, keys: tuple[str, ...], asker: str) -> Iterator[str]:
    for key in keys:
        if key in section.model_fields_set:
            yield f"{name}.{key} changes nothing here: it goes with {asker}; leave it out"

"""Unknowns of subdomains from an earlier result, at all its digits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.own_side import find_points_on_own_side
from ddic.parallel.team import require_held
from ddic.problem.cameras import Camera
from ddic.problem.views import ReferenceViews
from ddic.start.coarse_displacement import KeptResult, evaluate_at_nodes
from ddic.start.coarse_field import CoarseSearch, StartField, describe_starts, fit_coarse_fields
from ddic.start.given_start import EarlierResult
from ddic.start.multilevel import MultilevelStart

Array = NDArray[np.float64]


def fit_found_fields(search: CoarseSearch, references: Sequence[ReferenceViews],
                     found: Sequence[MultilevelStart]) -> StartField:
    """Start each subdomain from what was found for its camera, or from the earlier result that is kept; collective.

    Parameters
    ----------
    search : CoarseSearch
        With the earlier result, on rank 0.
    references : sequence of ReferenceViews
        Owned subdomains.
    found : sequence of MultilevelStart
        By camera.

    Returns
    -------
    StartField
        The result's displacement, moved as the set-ups did, so that no set-up has moved.

    Raises
    ------
    InputError
        On all ranks, where the earlier result holds no motion of a near field.
    """
    team, cameras = search.team, search.cameras
    if not any(isinstance(start.field, KeptResult) for start in found):
        return team.together(lambda: fit_coarse_fields(cameras, references, found))
    wanted = team.gather_to([(find_points_on_own_side(reference.subdomain.mesh), reference.subdomain.mesh.nodes)
                             for reference in references])

    def look_up() -> list[list[tuple[Array, NDArray[np.bool_]]]]:
        # All at once: the search trees of the earlier mesh are built once.
        of_ranks = require_held(wanted)
        on_own_side, nodes = _join([places for rank in of_ranks for places in rank])
        values, known = _require_result(search).evaluate(on_own_side, nodes)
        ends = np.cumsum([len(places) for rank in of_ranks for _, places in rank])[:-1]
        pieces = iter(zip(np.split(values, ends), np.split(known, ends), strict=True))
        return [[next(pieces) for _ in rank] for rank in of_ranks]

    looked_up = team.scatter_from_root(look_up)
    motions = team.on_root(lambda: [_require_result(search).get_motion(camera) for camera in cameras])

    def fit() -> list[Array]:
        q = []
        for reference, (u, known) in zip(references, looked_up, strict=True):
            number = reference.subdomain.camera
            field = found[number].field
            if isinstance(field, KeptResult):
                q.append(_fit_kept(reference, cameras[number], motions[number], (u, known), field))
            else:
                q += fit_coarse_fields(cameras, [reference], found).q
        return q

    return StartField(team.together(fit), describe_starts(cameras, found))


def _join(places: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Points on their own sides, and nodes, of all subdomains."""
    return np.concatenate([points for points, _ in places]), np.concatenate([nodes for _, nodes in places])


def _require_result(search: CoarseSearch) -> EarlierResult:
    if not isinstance(search.given, EarlierResult):
        raise TypeError("only an earlier result is kept")
    return search.given


def _fit_kept(reference: ReferenceViews, camera: Camera, motion: Array, looked_up: tuple[Array, NDArray[np.bool_]],
              field: KeptResult) -> Array:
    u, known = looked_up
    subdomain, setup = reference.subdomain, camera.setup
    nodes = subdomain.mesh.nodes
    moved = np.array(setup.move(nodes + u, motion))
    if not known.all():
        seen = reference.own.hold_still().kinematics.mesh
        in_image = evaluate_at_nodes(require_held(field.beyond), seen)[~known]
        moved[~known] = setup.mapping.to_specimen(seen.nodes[~known] + in_image)
    return subdomain.kinematics.fit((moved - nodes).ravel())

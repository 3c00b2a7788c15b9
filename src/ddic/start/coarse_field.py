"""The displacement that Gauss-Newton starts from [BP17, Fig. 5]: coarse fields of the cameras, or an earlier result."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from ddic.arrays import Array, BoolArray
from ddic.case.schema import Case, StartSection
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.functionals.view import View
from ddic.images.rigid import build_uniform_field
from ddic.images.sub_image import MaskedSource
from ddic.inputs.cameras import Camera, Frame, MeasuredCells
from ddic.inputs.inputs import Inputs
from ddic.kinematics.camera import CameraSetup, see_discontinuities
from ddic.kinematics.enriched import Discontinuities
from ddic.mesh.cut_mesh import find_points_on_own_side
from ddic.mesh.mesh import Mesh
from ddic.parallel.field import Field
from ddic.parallel.team import Team, require_held
from ddic.parallel.workers import Workers
from ddic.partition.subdomain import Subdomain
from ddic.problem.reference_problem import ReferenceProblem
from ddic.problem.region_mesh import list_discontinuities
from ddic.start.binned_pair import choose_held_block
from ddic.start.coarse_displacement import CoarseField, CutField, KeptResult, evaluate_at_nodes
from ddic.start.given_start import EarlierResult, GivenStart, PlacedStart, load_given_start, place_start
from ddic.start.helpers import Helpers, PairOfRank, hold_rows, split_rows
from ddic.start.multilevel import MultilevelStart, Pyramid, find_multilevel_start, find_start_from_given

Own = TypeVar("Own")

LookedUp = tuple[Array, BoolArray]
"""Displacement of a subdomain's nodes, (n_nodes, 2), pixels, and which of them are known, (n_nodes,)."""


SeenRegion = tuple[Mesh, Discontinuities]
"""The cells that a camera measures, and discontinuities of their displacement, its pixels."""


@dataclass(frozen=True)
class CoarseSearch:
    """The search for a coarse field of each camera: rigid FFT correlation and a pyramid.

    The last rank decides; all read the images and correlate what is too much for one.

    Attributes
    ----------
    team : Team
        All ranks.
    cameras : tuple of Camera
        With their reference images.
    section : StartSection
        Which stages the case asks for.
    correction : GreyCorrection
        Of grey levels.
    regions : list of SeenRegion or None
        By camera, on the last rank.
    given : EarlierResult, StartPoints or None
        What the user gives to start from, on rank 0 and on the last rank; another one may be put in its place on all.
    """

    team: Team
    cameras: tuple[Camera, ...]
    section: StartSection
    correction: GreyCorrection
    regions: list[SeenRegion] | None
    given: GivenStart | None = None

    def find(self, frame: Frame | None, before: Callable[[], Own]) -> tuple[Own, list[MultilevelStart] | None]:
        """Find a coarse field for each camera; collective.

        Each rank does work of its own ``before``, free of communication, and gets what it returned. The frame is None
        where there is nothing to search for yet; then nothing is found.
        """
        last = self.team.size - 1
        held = []
        if frame is not None and (self.section.rigid or self.section.pyramid):
            held = self.team.together(lambda: [self._hold_band(camera, deformed)
                                               for camera, deformed in zip(self.cameras, frame, strict=True)])
        workers = Workers(self.team, last, held)
        # First of all what is looked at as a whole is read, for rank 0 may be long at what it does before.
        _, pyramids = workers.run(lambda: self._open_pyramids(workers), lambda: None)
        own, found = workers.run(lambda: None if frame is None else self._search(require_held(pyramids)), before)
        # Not held by the last rank either where there was nothing to search for.
        return own, self.team.broadcast(found, root=last)

    def _hold_band(self, camera: Camera, deformed: MaskedSource) -> PairOfRank:
        """Rows of both images, in the smallest blocks that the start looks at."""
        image = camera.reference.image
        factor = choose_held_block(image.extent.sizes)
        rows_of_ranks = split_rows(image.extent.sizes[-1] // factor, self.team.size)
        return hold_rows(camera.reference, deformed, factor, rows_of_ranks[self.team.rank])

    def require_result(self) -> EarlierResult:
        """Give the earlier result that is kept; raises TypeError where the search does not start from one."""
        if not isinstance(self.given, EarlierResult):
            raise TypeError("only an earlier result is kept")
        return self.given

    def _open_pyramids(self, workers: Workers[list[PairOfRank]]) -> list[Pyramid]:
        """The images of each camera in blocks, those in memory that are looked at as a whole; none without images."""
        pyramids = []
        for images, camera, (mesh, discontinuities) in zip(workers.held, self.cameras, require_held(self.regions),
                                                           strict=False):
            pyramid = Pyramid(images.get_pair(images.factor), mesh, self.correction, discontinuities,
                              self.section.largest_enriched_block, Helpers(workers, camera.number))
            pyramid.read_whole(pyramid.rigid_size)
            pyramids.append(pyramid)
        return pyramids

    def _search(self, pyramids: Sequence[Pyramid]) -> list[MultilevelStart]:
        """The start of each camera's field; without images what is given, or rest."""
        found = []
        for (mesh, discontinuities), camera in zip(require_held(self.regions), self.cameras, strict=True):
            pyramid = pyramids[camera.number] if pyramids else None
            if self.given is not None:
                placed = place_start(self.given, mesh, discontinuities, camera)
                found.append(self._start_from(self.given, placed, pyramid))
            elif pyramid is not None:
                found.append(find_multilevel_start(pyramid, self.section))
            else:
                found.append(MultilevelStart(build_uniform_field((0.0,) * mesh.dim)))
        return found

    def _start_from(self, given: GivenStart, placed: PlacedStart, pyramid: Pyramid | None) -> MultilevelStart:
        """From what is given, with notes; an earlier result that is kept is looked up later, at all its digits."""
        start = MultilevelStart(placed.field)
        if pyramid is not None:
            start = find_start_from_given(placed.field, pyramid, self.section)
        notes = (f"start: {given.describe()}", *placed.notes, *start.notes)
        is_kept_result = start.field is placed.field and isinstance(given, EarlierResult)
        return replace(start, notes=notes, field=KeptResult(placed.beyond) if is_kept_result else start.field)


def prepare_search(team: Team, inputs: Inputs, measured: Sequence[MeasuredCells] | None) -> CoarseSearch:
    """Give the last rank the cells that rank 0 holds, so that rank 0 may split them meanwhile; collective.

    ``measured`` is by camera, on rank 0. The search serves any number of frames.
    """
    case, last = inputs.case, team.size - 1
    loaded = team.build_on_root(lambda: [load_given_start(case.start, case.dim)])
    sent = team.send_from_root(loaded, last)
    given = loaded if team.is_root else sent
    regions = None
    if measured is not None:
        regions = [_see_region(case, camera, cells) for camera, cells in zip(inputs.cameras, measured, strict=True)]
    return CoarseSearch(team, inputs.cameras, case.start, case.correlation.correction_of_start,
                        team.send_from_root(regions, last), None if given is None else given[0])


def _see_region(case: Case, camera: Camera, cells: MeasuredCells) -> SeenRegion:
    discontinuities = list_discontinuities(case)
    if camera.number > 0:
        discontinuities = see_discontinuities(discontinuities, cells.mesh, camera.setup.mapping)
    return cells.seen, discontinuities


def fit_found_fields(search: CoarseSearch, reference: ReferenceProblem,
                     found: Sequence[MultilevelStart]) -> tuple[Field, tuple[str, ...]]:
    """Start each subdomain from what was found for its camera, or from the earlier result that is kept; collective.

    That result, which the search holds on rank 0, gives its displacement, moved as the set-ups did, so that no set-up
    has moved: unknowns are those of the field, (n_field,). Notes how they were found come as well. Raises InputError on
    all ranks where the result holds no motion of a near field.
    """
    team, cameras, subdomains = search.team, search.cameras, reference.subdomains
    notes: list[str] = []
    for camera, start in zip(cameras, found, strict=True):
        prefix = "" if len(cameras) == 1 else f"{camera.label}, "
        notes += [prefix + line for line in start.describe()]
    own = [of_subdomain[0] for of_subdomain in reference.views]
    fields = [found[subdomain.camera].field for subdomain in subdomains]
    looked_up: Sequence[LookedUp | None] = [None] * len(subdomains)
    motions = [np.zeros(0)] * len(cameras)
    if any(isinstance(start.field, KeptResult) for start in found):
        looked_up = _look_up(search, subdomains)
        motions = team.on_root(lambda: [search.require_result().get_motion(camera) for camera in cameras])

    def fit(subdomain: Subdomain, view: View, field: CoarseField | KeptResult, of_nodes: LookedUp | None) -> Array:
        seen = view.kinematics.hold_still()
        if not isinstance(field, KeptResult):
            return seen.fit(evaluate_at_nodes(field, seen.mesh).ravel())
        camera = cameras[subdomain.camera]
        moved = _move_kept(subdomain, camera.setup, motions[camera.number], require_held(of_nodes), field.beyond,
                           seen.mesh)
        return subdomain.kinematics.fit((moved - subdomain.mesh.nodes).ravel())

    q = team.together(lambda: [fit(*of_subdomain)
                               for of_subdomain in zip(subdomains, own, fields, looked_up, strict=True)])
    return Field(team, subdomains, q), tuple(notes)


def _look_up(search: CoarseSearch, subdomains: Sequence[Subdomain]) -> list[LookedUp]:
    """The earlier result's displacement of the nodes of owned subdomains, which rank 0 knows; collective."""
    wanted = search.team.gather_to([(find_points_on_own_side(s.mesh), s.mesh.nodes) for s in subdomains])

    def look_up() -> list[list[LookedUp]]:
        # All at once: the search trees of the earlier mesh are built once.
        of_ranks = require_held(wanted)
        on_own_side, nodes = (np.concatenate([places[k] for rank in of_ranks for places in rank]) for k in range(2))
        values, known = search.require_result().evaluate(on_own_side, nodes)
        ends = np.cumsum([len(places) for rank in of_ranks for _, places in rank])[:-1]
        pieces = iter(zip(np.split(values, ends), np.split(known, ends), strict=True))
        return [[next(pieces) for _ in rank] for rank in of_ranks]

    return search.team.scatter_from_root(look_up)


def _move_kept(subdomain: Subdomain, setup: CameraSetup, motion: Array, looked_up: LookedUp, beyond: CutField | None,
               seen: Mesh) -> Array:
    """Where an earlier result puts the nodes, moved as the set-up did; ``seen`` is the mesh in the camera's pixels."""
    u, known = looked_up
    moved = np.array(setup.move(subdomain.mesh.nodes + u, motion))
    if not known.all():
        in_image = evaluate_at_nodes(require_held(beyond), seen)[~known]
        moved[~known] = setup.to_specimen(seen.nodes[~known] + in_image)
    return moved

"""The displacement that Gauss-Newton starts from [BP17, Fig. 5]: coarse fields of the cameras, or an earlier result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.case.schema import Case, StartSection
from ddic.errors import InputError
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.images.binned import bin_rows, join_blocks
from ddic.images.grid_field import build_uniform_field
from ddic.images.sub_image import MaskedSource
from ddic.io.result_reader import evaluate_on_sides, read_result
from ddic.io.result_schema import near_group
from ddic.kinematics.camera_kinematics import CameraSetup
from ddic.kinematics.seen_lines import see_discontinuities
from ddic.mesh.mesh import Mesh
from ddic.mesh.own_side import find_points_on_own_side
from ddic.parallel.team import Team, require_held
from ddic.problem.cameras import Camera, Frame, MeasuredCells
from ddic.problem.cut_region import list_discontinuities
from ddic.problem.inputs import Inputs
from ddic.problem.views import ReferenceViews
from ddic.start.binned_pair import BinnedPair
from ddic.start.coarse_displacement import evaluate_at_nodes
from ddic.start.multilevel import LinesOnLevels, MultilevelStart, Stages, choose_finest_block, find_multilevel_start

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StartField:
    """Where the independent measurements start.

    Attributes
    ----------
    q : list of (n_field,) array
        Field of each owned subdomain, as if no set-up had moved.
    notes : tuple of str
        How it was found.
    """

    q: list[Array]
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class SeenRegion:
    """What a camera sees of the region.

    Attributes
    ----------
    mesh : Mesh
        The cells that it measures, its pixels.
    lines : LinesOnLevels
        Discontinuities of the displacement, its pixels.
    """

    mesh: Mesh
    lines: LinesOnLevels


@dataclass(frozen=True)
class CoarseSearch:
    """The search for a coarse field of each camera: rigid FFT correlation and a pyramid, on the last rank.

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
    """

    team: Team
    cameras: tuple[Camera, ...]
    section: StartSection
    correction: GreyCorrection
    regions: list[SeenRegion] | None

    def prepare(self, frame: Frame | None) -> Callable[[], list[MultilevelStart] | None]:
        """Bin the images on all ranks; collective.

        Parameters
        ----------
        frame : Frame or None
            One deformed image of each camera; None where there is nothing to search for yet.

        Returns
        -------
        callable
            What this rank has to do next, free of communication: the search itself on the last rank.
        """
        if frame is None or self.section.from_result is not None:
            return lambda: None
        if not (self.section.rigid or self.section.pyramid):
            zero = MultilevelStart(build_uniform_field((0.0, 0.0)), (), (), ())
            return lambda: [zero] * len(self.cameras)
        pairs = [_bin_together(self.team, camera.reference, deformed)
                 for camera, deformed in zip(self.cameras, frame, strict=True)]
        return partial(self._search, pairs)

    def share(self, found: list[MultilevelStart] | None) -> list[MultilevelStart] | None:
        """Give all ranks what the last one found; collective.

        Parameters
        ----------
        found : list of MultilevelStart or None
            By camera, on the last rank.

        Returns
        -------
        list of MultilevelStart or None
            By camera; None where nothing was sought.
        """
        # Not held by the last rank either where there was nothing to search for.
        shared: list[MultilevelStart] | None = self.team.broadcast(found, root=self.team.size - 1)
        return shared

    def _search(self, pairs: Sequence[BinnedPair | None]) -> list[MultilevelStart] | None:
        if self.regions is None:
            return None
        stages = Stages(self.section.rigid, self.section.features, self.section.pyramid)
        return [find_multilevel_start(require_held(pair), region.mesh, stages, self.correction, region.lines)
                for pair, region in zip(pairs, self.regions, strict=True)]


def prepare_search(team: Team, inputs: Inputs, measured: Sequence[MeasuredCells] | None) -> CoarseSearch:
    """Give the last rank the cells that rank 0 holds, so that rank 0 may split them meanwhile; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    inputs : Inputs
        Reference images and settings.
    measured : sequence of MeasuredCells or None
        By camera, on rank 0.

    Returns
    -------
    CoarseSearch
        For any number of frames.
    """
    case = inputs.case
    regions = None
    if measured is not None:
        regions = [_see_region(case, camera, cells) for camera, cells in zip(inputs.cameras, measured, strict=True)]
    return CoarseSearch(team, inputs.cameras, case.start, case.correlation.correction_of_start,
                        team.send_from_root(regions, team.size - 1))


def _see_region(case: Case, camera: Camera, cells: MeasuredCells) -> SeenRegion:
    discontinuities = list_discontinuities(case)
    if camera.number > 0:
        discontinuities = see_discontinuities(discontinuities, cells.mesh, camera.setup.mapping)
    return SeenRegion(cells.seen, LinesOnLevels(discontinuities, case.start.largest_enriched_block))


def fit_coarse_fields(cameras: Sequence[Camera], references: Sequence[ReferenceViews],
                      found: Sequence[MultilevelStart]) -> StartField:
    """Start each subdomain from its camera's coarse field; free of communication.

    Parameters
    ----------
    cameras : sequence of Camera
        All of them.
    references : sequence of ReferenceViews
        Owned subdomains.
    found : sequence of MultilevelStart
        By camera.

    Returns
    -------
    StartField
        Unknowns and notes.
    """
    q = []
    for reference in references:
        still = reference.own.hold_still().kinematics
        in_image = evaluate_at_nodes(found[reference.subdomain.camera].field, still.mesh)
        q.append(still.fit(in_image.ravel()))
    notes: list[str] = []
    for camera, start in zip(cameras, found, strict=True):
        prefix = "" if len(cameras) == 1 else f"{camera.label}, "
        notes += [prefix + line for line in describe_start(start)]
    return StartField(q, tuple(notes))


def describe_start(start: MultilevelStart) -> list[str]:
    """Say how a coarse field was found.

    Parameters
    ----------
    start : MultilevelStart
        The coarse field.

    Returns
    -------
    list of str
        For the log.
    """
    lines = list(start.warnings)
    shifts = [f"({found.shift[0]:.2f}, {found.shift[1]:.2f}) px, correlation coefficient {found.coefficient:.3f}"
              for found in start.rigid]
    lines = [*(f"start: rigid shift {shift}" for shift in shifts), *lines]
    if start.n_matches:
        lines.append(f"start: {start.n_matches} of {start.n_found} matched features agree with their neighbours")
    if start.levels:
        blocks = ", ".join(str(level) for level in start.levels)
        lines.append(f"start: pyramid on blocks of {blocks} px")
    return lines


def _bin_together(team: Team, reference: MaskedSource, deformed: MaskedSource) -> BinnedPair | None:
    """Both images in the smallest blocks that the start looks at, on the last rank; each rank bins a band of rows."""
    image = reference.image
    factor = choose_finest_block(image.width * image.height)
    edges = np.linspace(0, image.height // factor, team.size + 1).astype(int)
    mine = range(int(edges[team.rank]), int(edges[team.rank + 1]))
    sources = (reference, deformed)
    own = team.together(lambda: [bin_rows(source, factor, mine) for source in sources])
    bands = team.gather_to(own, team.size - 1)
    if bands is None:
        return None
    binned = [join_blocks(source, [of_rank[k] for of_rank in bands]) for k, source in enumerate(sources)]
    return BinnedPair(binned[0], binned[1], factor)


def read_earlier_fields(team: Team, path: Path, cameras: Sequence[Camera],
                        references: Sequence[ReferenceViews]) -> StartField:
    """Start each subdomain from an earlier result; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    path : Path
        The result file.
    cameras : sequence of Camera
        All of them.
    references : sequence of ReferenceViews
        Owned subdomains.

    Returns
    -------
    StartField
        The result's displacement, moved as the set-ups did, so that no set-up has moved.

    Raises
    ------
    InputError
        On all ranks, where the file is no result, or holds no motion of a near field.
    """
    wanted = team.gather_to([(find_points_on_own_side(reference.subdomain.mesh), reference.subdomain.mesh.nodes)
                             for reference in references])

    def read() -> list[list[Array]]:
        result = read_result(path)
        return [[evaluate_on_sides(result, points, nodes) for points, nodes in of_rank]
                for of_rank in require_held(wanted)]

    displacements = team.scatter_from_root(read)
    motions = team.on_root(lambda: [_stored_motion(path, camera) for camera in cameras])

    def fit(reference: ReferenceViews, u: Array) -> Array:
        subdomain = reference.subdomain
        nodes = subdomain.mesh.nodes
        moved = cameras[subdomain.camera].setup.move(nodes + u, motions[subdomain.camera])
        return subdomain.kinematics.fit((moved - nodes).ravel())

    q = team.together(lambda: [fit(reference, u) for reference, u in zip(references, displacements, strict=True)])
    labels = [""] if len(cameras) == 1 else [f"{camera.label}, " for camera in cameras]
    return StartField(q, tuple(f"{label}start: displacement of {path}" for label in labels))


def _stored_motion(path: Path, camera: Camera) -> Array:
    """Unknowns of a set-up's motion in an earlier result, (n_motion_unknowns,)."""
    setup: CameraSetup = camera.setup
    if camera.number == 0:
        return np.zeros(0)
    stored = read_result(path).attributes.get(near_group(camera.number), {})
    if "alpha_px" not in stored:
        raise InputError(f"start.from_result: {path} holds no motion of near field {camera.number}; give a "
                         "result of the same near-field images")
    alpha = stored["alpha_px"]
    theta = float(stored["theta_rad"])
    return np.array([alpha[0], alpha[1], theta * setup.length])[:setup.n_motion_unknowns]

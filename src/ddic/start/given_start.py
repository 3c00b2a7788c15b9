"""A displacement that the user gives to start from, brought to the mesh of a region.

Beyond where it is known it is in equilibrium with what is known.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray
from ddic.case.schema import StartSection
from ddic.errors import InputError
from ddic.functionals.regularization import Material, assemble_stiffness
from ddic.inputs.cameras import Camera
from ddic.inputs.inputs import StartPoints, check_start_points, load_start_points, require_points_inside
from ddic.io.result_reader import SAME_NODE_PX, Result, evaluate_on_sides, require_known_displacement
from ddic.io.result_schema import near_group
from ddic.io.series_reader import read_frame_or_last
from ddic.kinematics.enriched import Discontinuities
from ddic.mesh.cut_mesh import cut_mesh, find_points_on_own_side
from ddic.mesh.interpolation import locate
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import build_tree
from ddic.mesh.topology import find_boundary_facets
from ddic.solvers.local_operator import LocalOperator
from ddic.start.coarse_displacement import CutField
from ddic.start.feature_matches import (
    AffineMap,
    ExtendedField,
    find_piece_of_nodes,
    fit_affine_map,
    interpolate_pairs,
)

N_FACETS = 8
"""Edges of the earlier mesh, by their middles, among which the nearest to a point is sought."""

HELD = 1e-9
"""Stiffness, times the mean of K's diagonal, that holds nodes to the affine map of what is known: where one node of a
piece is known, nothing else keeps the piece from turning about it. A larger value lets deformation fade sooner."""


@dataclass(frozen=True, eq=False)
class EarlierResult:
    """A result to start from.

    Attributes
    ----------
    result : Result
        Its mesh and displacement, and how near set-ups moved.
    name : str
        The file, or what stands for it, for the log and for messages.
    """

    result: Result
    name: str

    def describe(self) -> str:
        """Say for the log what it is."""
        return f"displacement of {self.name}"

    def evaluate(self, on_own_side: Array, nodes: Array) -> tuple[Array, BoolArray]:
        """Evaluate the displacement at nodes, (n, 2), and tell which are known, (n,); pixels of the specimen's frame.

        ``on_own_side`` holds a point for each node on its side of all discontinuities. A node is known where its point
        lies in the earlier mesh, where that was measured; the displacement of others is 0.
        """
        known = self._find_measured(on_own_side)
        values = np.zeros_like(nodes)
        if known.any():
            values[known] = evaluate_on_sides(self.result, on_own_side[known], nodes[known])
            # From a point beside its node the slope leads on, which cells with a node that was not measured lack.
            known &= np.isfinite(values).all(axis=1)
            values[~known] = 0.0
        return values, known

    def _find_measured(self, points: Array) -> BoolArray:
        measured = np.asarray(np.isfinite(self.result.at(points)).all(axis=1))
        nodes = self.result.mesh.nodes[self.result.measured_nodes]
        if self.result.separated is None and not measured.all() and len(nodes):
            measured[~measured] = build_tree(nodes).query(points[~measured])[0] <= SAME_NODE_PX
        return measured

    def find_outside(self, points: Array) -> BoolArray:
        """Find the points outside the earlier mesh among those, (n, 2), pixels, of which ``evaluate`` knows nothing.

        The others lie where nothing was measured.
        """
        if self.result.separated is not None:
            return np.ones(len(points), dtype=bool)
        return np.asarray(locate(self.result.mesh, points).cells < 0)

    def get_motion(self, camera: Camera) -> Array:
        """Get how a set-up moved, (n_motion_unknowns,), pixels; none of the far camera.

        Raises InputError where the result holds no motion of this near field.
        """
        if camera.number == 0:
            return np.zeros(0)
        stored = self.result.attributes.get(near_group(camera.number), {})
        if "alpha_px" not in stored:
            raise InputError(f"start.from_result: {self.name} holds no motion of near field {camera.number}; give a "
                             "result of the same near-field images")
        alpha = stored["alpha_px"]
        theta = float(stored["theta_rad"])
        unknowns = np.array([alpha[0], alpha[1], theta * camera.setup.length])
        return unknowns[:camera.setup.n_motion_unknowns]


GivenStart = EarlierResult | StartPoints
"""What the user gives to start from."""


@dataclass(frozen=True, eq=False)
class PlacedStart:
    """What the user gives, on the mesh of a camera's region.

    Attributes
    ----------
    field : CutField
        Displacement at all nodes, pixels of the camera, as if no set-up had moved.
    beyond : CutField or None
        The same on the cells that an earlier result does not hold whole, by which it is extended; None where there are
        none.
    notes : tuple of str
        What the user should know of it.
    """

    field: CutField
    beyond: CutField | None
    notes: tuple[str, ...]


def load_given_start(section: StartSection) -> GivenStart | None:
    """Load what a case gives to start from; None where it gives nothing.

    Raises InputError where a file is missing or holds something else.
    """
    if section.from_result is not None:
        result, name = read_frame_or_last(section.from_result, section.frame, "start.frame =")
        require_known_displacement(result)
        return keep_displacement(result, name)
    return load_start_points(section)


def keep_displacement(result: Result, name: str) -> EarlierResult:
    """Keep of a result what another run starts from: small enough to be sent to another rank."""
    return EarlierResult(replace(result, point_data={}, cell_data={}, gauss_newton={}, krylov=(), corrections={}), name)


def place_start(given: GivenStart, region: Mesh, discontinuities: Discontinuities, camera: Camera) -> PlacedStart:
    """Bring what the user gives, in the specimen's frame, to the nodes of a camera's region, cut by the lines.

    The region and its discontinuities are in the camera's pixels. Raises InputError where what is given says nothing of
    the region.
    """
    mesh = cut_mesh(region, discontinuities.lines).mesh
    if isinstance(given, StartPoints):
        return _place_points(given, mesh, camera)
    return _place_result(given, mesh, camera)


def _place_points(given: StartPoints, mesh: Mesh, camera: Camera) -> PlacedStart:
    mapping = camera.setup.mapping
    if camera.number == 0:
        image = camera.reference.image
        check_start_points(given, image.width, image.height)
        require_points_inside(given, mesh)
    points = mapping.to_image(given.points)
    found = interpolate_pairs(points, mapping.to_image(given.points + given.displacement) - points, mesh)
    notes = _note_pieces(found.n_pieces_without, "point")
    return PlacedStart(CutField(mesh, found.displacement), None, notes)


def _place_result(given: EarlierResult, mesh: Mesh, camera: Camera) -> PlacedStart:
    setup = camera.setup
    nodes, on_own_side = setup.mapping.to_specimen(mesh.nodes), setup.mapping.to_specimen(find_points_on_own_side(mesh))
    values, known = given.evaluate(on_own_side, nodes)
    if not known.any():
        raise InputError(f"start.from_result: the mesh of {given.name} holds no node of this measurement's, or none "
                         "that was measured; give a result of the same specimen, in pixels of the same reference image")
    moved = setup.move(nodes[known] + values[known], given.get_motion(camera))
    displacement = np.zeros_like(mesh.nodes)
    displacement[known] = setup.mapping.to_image(moved) - mesh.nodes[known]
    if known.all():
        return PlacedStart(CutField(mesh, displacement), None, ())
    extended = extrapolate(mesh, displacement, known)
    touched = ((mesh.cells >= 0) & ~known[mesh.cells]).any(axis=1)
    part, of_part = mesh.create_submesh(np.flatnonzero(touched))
    notes = (*_note_extrapolated(given, on_own_side[~known]),
             *_note_pieces(extended.n_pieces_without, "node of the earlier mesh"))
    return PlacedStart(CutField(mesh, extended.displacement), CutField(part, extended.displacement[of_part]), notes)


def _note_extrapolated(given: EarlierResult, unknown: Array) -> tuple[str, ...]:
    """Say of nodes, by points on their own sides, why nothing is known of them."""
    is_outside = given.find_outside(unknown)
    n_outside, n_unmeasured = int(is_outside.sum()), int((~is_outside).sum())
    notes = []
    if n_outside:
        count = "1 node lies" if n_outside == 1 else f"{n_outside} nodes lie"
        farthest = _measure_distances(given.result.mesh, unknown[is_outside]).max()
        notes.append(f"start: {count} outside the mesh of {given.name}, by {farthest:.1f} px at most; displacement "
                     "extrapolated by equilibrium")
    if n_unmeasured:
        count = "1 node lies" if n_unmeasured == 1 else f"{n_unmeasured} nodes lie"
        notes.append(f"start: {count} where {given.name} measured nothing; displacement extrapolated by equilibrium")
    return tuple(notes)


def _note_pieces(n_pieces: int, what: str) -> tuple[str, ...]:
    if not n_pieces:
        return ()
    pieces = "1 piece of the mesh holds" if n_pieces == 1 else f"{n_pieces} pieces of the mesh hold"
    return (f"start: {pieces} no {what}; the affine map of the nearest piece stands in",)


def _measure_distances(mesh: Mesh, points: Array) -> Array:
    """Distance of points outside a mesh from its boundary, pixels."""
    ends = mesh.nodes[find_boundary_facets(mesh)[:, :2]]
    n_facets = min(N_FACETS, len(ends))
    near = build_tree(ends.mean(axis=1)).query(points, list(range(1, n_facets + 1)))[1]
    first, along = ends[near, 0], ends[near, 1] - ends[near, 0]
    share = ((points[:, None] - first) * along).sum(axis=2) / np.maximum((along**2).sum(axis=2), 1e-300)
    feet = first + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.asarray(np.linalg.norm(points[:, None] - feet, axis=2).min(axis=1))


def extrapolate(mesh: Mesh, displacement: Array, known: BoolArray) -> ExtendedField:
    """Extrapolate a displacement, (n_nodes, 2), pixels, from the nodes at which it is known, at least one.

    In each piece the affine map nearest to what is known goes on, and what this leaves is in equilibrium, with free
    edges: rotations and homogeneous strains are extrapolated exactly. Where it is known it stays as given; elsewhere it
    is not looked at. The mesh is perhaps cut by lines.
    """
    values = np.where(known[:, None], displacement, 0.0)
    pieces = find_piece_of_nodes(mesh)
    maps: dict[int, AffineMap] = {}
    for piece in np.unique(pieces[known]):
        own = known & (pieces == piece)
        maps[int(piece)] = fit_affine_map(mesh.nodes[own], displacement[own])
    places = np.flatnonzero(known)
    nearest = places[build_tree(mesh.nodes[known]).query(mesh.nodes)[1]]
    from_piece = np.where(np.isin(pieces, list(maps)), pieces, pieces[nearest])
    background = np.empty_like(values)
    for piece, of_piece in maps.items():
        members = from_piece == piece
        background[members] = of_piece.at(mesh.nodes[members])
    values[~known] = background[~known]
    values += _balance(mesh, np.where(known[:, None], values - background, 0.0), known)
    return ExtendedField(values, len(np.unique(pieces)) - len(maps))


def _balance(mesh: Mesh, prescribed: Array, known: BoolArray) -> Array:
    """Displacement of unknown nodes in equilibrium with prescribed ones; 0 at these."""
    values = np.zeros_like(prescribed)
    padded = mesh.cells
    touched = ((padded >= 0) & ~known[padded]).any(axis=1)
    if not touched.any():
        return values
    part, nodes = mesh.create_submesh(np.flatnonzero(touched))
    stiffness = assemble_stiffness(part, Material()).tocsr()
    is_free = np.repeat(~known[nodes], mesh.dim)
    free, held = np.flatnonzero(is_free), np.flatnonzero(~is_free)
    inside = stiffness[free][:, free]
    ridge = HELD * float(inside.diagonal().mean())
    operator = LocalOperator((inside + ridge * sparse.identity(len(free), format="csr")).tocsr(),
                             smallest_eigenvalue=0.0, where="extrapolation of the start")
    try:
        found = operator.solve(-stiffness[free][:, held] @ prescribed[nodes].ravel()[held])
    finally:
        operator.destroy()
    of_part = np.zeros(part.n_dofs)
    of_part[free] = found
    values[nodes] = of_part.reshape(-1, mesh.dim)
    return values

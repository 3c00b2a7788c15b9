"""A displacement that the user gives to start from, brought to the mesh of a region.

Points say what lies between them. Beyond where a result is known it is in equilibrium with what is known.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.case.schema import StartSection
from ddic.errors import InputError
from ddic.functionals.regularization import Material, assemble_stiffness
from ddic.inputs.cameras import Camera
from ddic.inputs.inputs import StartPoints, check_start_points, load_start_points, require_points_inside
from ddic.io.result_reader import SAME_NODE_PX, Result, evaluate_on_sides, require_known_displacement
from ddic.io.result_schema import near_group
from ddic.io.series_reader import read_frame_or_last
from ddic.kinematics.enriched import Discontinuities
from ddic.kinematics.motions import AffineMap, fit_affine_map, interpolate_robustly
from ddic.mesh.cut_mesh import cut_mesh, find_points_on_own_side
from ddic.mesh.interpolation import locate
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import build_tree
from ddic.mesh.topology import find_boundary_facets, find_boundary_nodes
from ddic.solvers.local_system import LocalOperator
from ddic.start.coarse_displacement import CutField
from ddic.start.feature_matches import find_piece_of_nodes, find_pieces

N_FACETS = 8
"""Edges of the earlier mesh, by their middles, among which the nearest to a point is sought."""

EXACT = 1e-9
"""What an affine map may leave of the displacements, pixels, to be taken for all of them: rounding."""

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
        """Get how a set-up moved, (n_motion_unknowns,), pixels; InputError where that of a near one is not held."""
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


def load_given_start(section: StartSection, dim: int) -> GivenStart | None:
    """Load what a case in ``dim`` dimensions gives to start from, None where it gives nothing.

    Raises InputError where a file is wrong.
    """
    if section.from_result is not None:
        result, name = read_frame_or_last(section.from_result, section.frame, "start.frame =")
        if result.mesh.dim != dim:
            raise InputError(f"start.from_result = {section.from_result}: a field in {result.mesh.dim} dimensions, the "
                             f"case has {dim}; start from another result")
        require_known_displacement(result)
        return keep_displacement(result, name)
    return load_start_points(section, dim)


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
    setup = camera.setup
    if camera.number == 0:
        image = camera.reference.image
        check_start_points(given, image.extent)
        require_points_inside(given, mesh)
    points = setup.to_image(given.points)
    found = interpolate_pairs(points, setup.to_image(given.points + given.displacement) - points, mesh)
    notes = _note_pieces(found.n_pieces_without, "point")
    return PlacedStart(CutField(mesh, found.displacement), None, notes)


def _place_result(given: EarlierResult, mesh: Mesh, camera: Camera) -> PlacedStart:
    setup = camera.setup
    nodes, on_own_side = setup.to_specimen(mesh.nodes), setup.to_specimen(find_points_on_own_side(mesh))
    values, known = given.evaluate(on_own_side, nodes)
    if not known.any():
        raise InputError(f"start.from_result: the mesh of {given.name} holds no node of this measurement's, or none "
                         "that was measured; give a result of the same specimen, in pixels of the same reference image")
    moved = setup.move(nodes[known] + values[known], given.get_motion(camera))
    displacement = np.zeros_like(mesh.nodes)
    displacement[known] = setup.to_image(moved) - mesh.nodes[known]
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
    is_outside, name, places = given.find_outside(unknown), given.name, []
    if is_outside.any():
        farthest = _measure_distances(given.result.mesh, unknown[is_outside]).max()
        places.append((int(is_outside.sum()), f"outside the mesh of {name}, by {farthest:.1f} px at most"))
    if not is_outside.all():
        places.append((int((~is_outside).sum()), f"where {name} measured nothing"))
    counts = [("1 node lies" if n == 1 else f"{n} nodes lie", place) for n, place in places]
    return tuple(f"start: {count} {place}; displacement extrapolated by equilibrium" for count, place in counts)


def _note_pieces(n_pieces: int, what: str) -> tuple[str, ...]:
    if not n_pieces:
        return ()
    pieces = "1 piece of the mesh holds" if n_pieces == 1 else f"{n_pieces} pieces of the mesh hold"
    return (f"start: {pieces} no {what}; the affine map of the nearest piece stands in",)


def _measure_distances(mesh: Mesh, points: Array) -> Array:
    """Distance of points outside a mesh from its boundary, or from the nearest node there in space, pixels."""
    if mesh.dim == 3:
        return np.asarray(build_tree(mesh.nodes[find_boundary_nodes(mesh)]).query(points)[0])
    ends = mesh.nodes[find_boundary_facets(mesh)[:, :2]]
    n_facets = min(N_FACETS, len(ends))
    near = build_tree(ends.mean(axis=1)).query(points, list(range(1, n_facets + 1)))[1]
    first, along = ends[near, 0], ends[near, 1] - ends[near, 0]
    share = ((points[:, None] - first) * along).sum(axis=2) / np.maximum((along**2).sum(axis=2), 1e-300)
    feet = first + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.asarray(np.linalg.norm(points[:, None] - feet, axis=2).min(axis=1))


@dataclass(frozen=True, eq=False)
class ExtendedField:
    """A displacement at the nodes of a mesh, of which it was known somewhere.

    Attributes
    ----------
    displacement : (n_nodes, 2) array
        Pixels.
    n_pieces_without : int
        Pieces of the mesh in which it was known nowhere: they move with the affine map of what is nearest.
    """

    displacement: Array
    n_pieces_without: int


def interpolate_pairs(points: Array, displacement: Array, mesh: Mesh) -> ExtendedField:
    """Interpolate displacements, (n, 2), at points, (n, 2), pixels, to a mesh, each piece of it for itself.

    One point says a translation, two a rotation with a scale, three an affine map; what this leaves of more points is
    interpolated by affine maps of the nearest ones, of which some may be wrong. At least one point is needed.
    """
    pieces = find_piece_of_nodes(mesh)
    cells = locate(mesh, points).cells
    nearest_node = build_tree(mesh.nodes).query(points)[1]
    piece_of_point = np.where(cells >= 0, find_pieces(mesh)[cells], pieces[nearest_node])
    values, maps, from_piece = _fit_pieces(mesh, pieces, points, displacement, piece_of_point)
    for piece, of_piece in maps.items():
        own, places = piece_of_point == piece, mesh.nodes[from_piece == piece]
        rest = displacement[own] - of_piece.at(points[own])
        if np.abs(rest).max() > EXACT * max(1.0, float(np.abs(displacement[own]).max())):
            values[from_piece == piece] += interpolate_robustly(points[own], rest, places)
    return ExtendedField(values, int(pieces.max()) + 1 - len(maps))


def extrapolate(mesh: Mesh, displacement: Array, known: BoolArray) -> ExtendedField:
    """Extrapolate a displacement, (n_nodes, 2), pixels, from the nodes at which it is known, at least one.

    In each piece the affine map nearest to what is known goes on, and what this leaves is in equilibrium, with free
    edges: rotations and homogeneous strains are extrapolated exactly. Where it is known it stays as given; elsewhere it
    is not looked at. The mesh is perhaps cut by lines.
    """
    pieces = find_piece_of_nodes(mesh)
    background, maps, _ = _fit_pieces(mesh, pieces, mesh.nodes[known], displacement[known], pieces[known])
    values = np.where(known[:, None], displacement, background)
    values += _balance(mesh, values - background, known)
    return ExtendedField(values, int(pieces.max()) + 1 - len(maps))


def _fit_pieces(mesh: Mesh, pieces: IntArray, points: Array, displacement: Array,
                piece_of_point: IntArray) -> tuple[Array, dict[int, AffineMap], IntArray]:
    """Displacement of nodes by affine maps of displacements at points, one of each piece that holds some, and the maps.

    ``pieces`` are those of the nodes. Beside it the piece whose map each node follows: its own, or the nearest.
    """
    nearest = build_tree(points).query(mesh.nodes)[1]
    from_piece = np.where(np.isin(pieces, piece_of_point), pieces, piece_of_point[nearest])
    maps, values = {}, np.empty_like(mesh.nodes)
    for piece in np.unique(piece_of_point).tolist():
        own, members = piece_of_point == piece, from_piece == piece
        maps[piece] = fit_affine_map(points[own], displacement[own])
        values[members] = maps[piece].at(mesh.nodes[members])
    return values, maps, from_piece


def _balance(mesh: Mesh, prescribed: Array, known: BoolArray) -> Array:
    """Displacement of unknown nodes in equilibrium with prescribed ones; 0 at these."""
    values = np.zeros_like(prescribed)
    padded = mesh.cells
    touched = ((padded >= 0) & ~known[padded]).any(axis=1)
    if not touched.any():
        return values
    part, nodes = mesh.create_submesh(np.flatnonzero(touched))
    stiffness = assemble_stiffness(part, Material.default(mesh.dim)).tocsr()
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

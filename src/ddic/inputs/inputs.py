"""What a measurement is made from: cameras with reference images, a mesh, a case's settings; points to start from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.case.loader import LoadedCase
from ddic.case.named_files import choose_frame, list_cameras, list_deformed
from ddic.case.schema import Case, StartSection
from ddic.errors import DdicError, InputError, as_collective, is_collective
from ddic.images.source import ImageSource
from ddic.images.window import Window
from ddic.inputs.cameras import Camera, Frame, open_cameras, open_frame, open_on_all_ranks
from ddic.inputs.mesh_source import build_meshes
from ddic.io.input_file import FileStamps, list_parts
from ddic.io.text_files import read_point_table
from ddic.kinematics.kinematics import RegionKinematics
from ddic.mesh.interpolation import locate
from ddic.mesh.mesh import Mesh
from ddic.mesh.repair import check_inside
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.partition.ties import Tying


@dataclass(frozen=True)
class Inputs:
    """What a measurement is made from, on every rank.

    Attributes
    ----------
    case : Case
        Settings of correlation, regularization, solver, Gauss-Newton and start.
    cameras : tuple of Camera
        With their reference images.
    build_mesh : callable
        Gives the whole mesh, and how near fields' own meshes are tied in it (None where there are none); called on rank
        0 only.
    choose_kinematics : callable, optional
        From the whole mesh to its kinematics, called on rank 0 only; None for displacements of nodes.
    case_path, case_text : Path, str
        The case file and its content; empty where there is none.
    notes : tuple of str
        What the user should know of how the case was completed.
    given_mesh : Mesh, optional
        The mesh where it was given in memory, as it was given; None where the case says it.
    n_frames : int
        Frames that are expected, where the case does not say it.
    choice : SolverChoice, optional
        What was chosen of what the case left open; None where it left nothing open, or nothing has been chosen yet.
    updated : UpdatedReference, optional
        What is known of the mesh where a later frame has taken the place of the reference image; None where none has.
    """

    case: Case
    cameras: tuple[Camera, ...]
    build_mesh: Callable[[], tuple[Mesh, Tying | None]]
    choose_kinematics: Callable[[Mesh], RegionKinematics] | None = None
    case_path: Path = Path()
    case_text: str = ""
    notes: tuple[str, ...] = ()
    given_mesh: Mesh | None = None
    n_frames: int = 1
    choice: SolverChoice | None = None
    updated: UpdatedReference | None = None

    def with_frame(self, number: int) -> Inputs:
        """Give the inputs of one frame of a series, counted from 0, with its images in the case."""
        choice = self.choice
        if choice is not None:
            choice = replace(choice, asked=choose_frame(choice.asked, number), case=choose_frame(choice.case, number))
        return replace(self, case=choose_frame(self.case, number), choice=choice)

    @property
    def asked_case(self) -> Case:
        """The case as it was given."""
        return self.case if self.choice is None else self.choice.asked


def open_inputs(team: Team, loaded: LoadedCase, number: int = 0) -> tuple[Inputs, Frame]:
    """Open the images of a case on all ranks; collective.

    ``number`` is that of the frame of a series, from 0. Raises InputError on all ranks, where an image or a mapping
    cannot be read.
    """
    case = loaded.case
    opener = open_on_all_ranks(team, case.dim)
    cameras = open_cameras(case, opener)
    image = cameras[0].reference.image
    inputs = Inputs(case, cameras, lambda: loaded.kept_mesh.take(case) or build_meshes(case, image.extent),
                    case_path=loaded.path, case_text=loaded.text,
                    n_frames=len(list_deformed(case.imaging)))
    return inputs, open_frame(case, opener, number)


@contextmanager
def inputs_kept(team: Team, stamps: FileStamps) -> Iterator[None]:
    """Refuse what the block finds where its inputs were not the same from their check to its end; collective.

    ``stamps`` are those of the inputs when they were checked. Raises InputError on all ranks, with a line for each file
    that has changed or vanished, in place of what the block raises.
    """
    try:
        yield
    except (DdicError, OSError) as error:
        if is_collective(error):
            _require_same(team, stamps, error)
        raise
    _require_same(team, stamps, None)


def _require_same(team: Team, stamps: FileStamps, error: Exception | None) -> None:
    changes = team.on_root(stamps.list_changes)
    if changes:
        raise as_collective(InputError(changes)) from error


@dataclass(frozen=True)
class FrameOpener:
    """Opens frames of a series by their numbers, which count from 1.

    Attributes
    ----------
    team, inputs : Team, Inputs
        All ranks, and inputs with the case of the whole series.
    first_number, first : int, Frame
        Number, from 1, and images of a frame that is open already.
    stamps : FileStamps
        Of the images when they were checked.
    """

    team: Team
    inputs: Inputs
    first_number: int
    first: Frame
    stamps: FileStamps = field(default_factory=FileStamps)

    @property
    def n_frames(self) -> int:
        """Of the series."""
        return len(list_deformed(self.inputs.case.imaging))

    def open(self, number: int) -> Frame:
        """Open a frame's images, one a camera; collective, raises InputError on all ranks where one cannot be read."""
        if number == self.first_number:
            return self.first
        return open_frame(self.inputs.case, open_on_all_ranks(self.team, self.inputs.case.dim), number - 1)

    def list_files(self, number: int) -> list[Path]:
        """List the files that make the images of a frame, one of each camera; none behind the last."""
        if number > self.n_frames:
            return []
        return [file for section in list_cameras(self.inputs.case)
                for file in list_parts(list_deformed(section)[number - 1])]

    def choose_stamps(self, number: int) -> FileStamps:
        """Choose the stamps of what a frame is measured from: of its images and the reference images."""
        references = [section.reference for section in list_cameras(self.inputs.case)]
        return self.stamps.choose([*references, *self.list_files(number)])

    def describe(self, number: int) -> str:
        """Describe a frame by the file of the far camera's image."""
        return str(list_deformed(self.inputs.case.imaging)[number - 1])


@dataclass(frozen=True)
class SolverChoice:
    """What ``solver.method = "auto"`` came to.

    Attributes
    ----------
    asked, case : Case
        As it was given, and with method, number of subdomains and preconditioner.
    note : str
        What was chosen and why, a line for the log.
    most_iterations : int or None
        Conjugate gradients' iterations after which a step is factorised instead; None where it cannot be, or need not.
    """

    asked: Case
    case: Case
    note: str
    most_iterations: int | None


@dataclass(frozen=True, eq=False)
class UpdatedReference:
    """What the mesh was in the first reference image, and where it is now.

    Attributes
    ----------
    nodes, displacement : (n_nodes, 2) array
        In the first reference image, and from there to the frame, pixels.
    parts : (n_cells,) array of int64
        Subdomain of each cell, as in the first reference image.
    first_image : ImageSource
        The first reference image.
    build_first_mesh : callable
        Gives the whole mesh in the first reference image; called on rank 0 only.
    """

    nodes: Array
    displacement: Array
    parts: IntArray
    first_image: ImageSource
    build_first_mesh: Callable[[], tuple[Mesh, Tying | None]]

    def build_moved_mesh(self, extent: Window) -> Mesh:
        """Build the mesh where the frame shows it; on rank 0. Raises InputError where it has left the image."""
        mesh, _ = self.build_first_mesh()
        moved = replace(mesh, nodes=mesh.nodes + self.displacement)
        check_inside(moved, extent)
        return moved

    def place_first(self, subdomain: Subdomain) -> Subdomain:
        """Give a subdomain of the moved mesh the nodes that it has in the first reference image."""
        return replace(subdomain, mesh=replace(subdomain.mesh, nodes=self.nodes[subdomain.node_ids]))

    def restrict(self, subdomains: Sequence[Subdomain]) -> list[Array]:
        """Give subdomains, whose unknowns are displacements of nodes, those to the frame, (n_dofs,), pixels."""
        return [self.displacement[subdomain.node_ids].ravel() for subdomain in subdomains]


@dataclass(frozen=True, eq=False)
class StartPoints:
    """Displacements at points.

    Attributes
    ----------
    points, displacement : (n, dim) array
        Where they are in the reference image, and how far they move, pixels.
    name : str
        Where they come from, for the log and for messages.
    rows : (n,) array of int64, optional
        Rows of the table that they were read from.
    """

    points: Array
    displacement: Array
    name: str
    rows: IntArray | None = None

    def describe(self) -> str:
        """Say for the log what they are."""
        n = len(self.points)
        return f"displacement at {n} {'point' if n == 1 else 'points'} of {self.name}"

    def describe_point(self, number: int) -> str:
        """Say for messages which point it is; the number counts from 0."""
        return f"{self.name}[{number}]" if self.rows is None else f"{self.name}: row {self.rows[number]}"


def load_start_points(section: StartSection, dim: int) -> StartPoints | None:
    """Load the points that a case starts from, None where it gives none; InputError where their table is wrong."""
    if section.from_points is not None:
        values, rows = read_point_table(section.from_points, dim)
        return StartPoints(values[:, :dim], values[:, dim:], str(section.from_points), rows)
    if section.points is not None:
        pairs = np.array(section.points, dtype=np.float64)
        return StartPoints(pairs[:, :dim], pairs[:, dim:] - pairs[:, :dim], "start.points")
    return None


def check_start_points(given: StartPoints, extent: Window) -> None:
    """Raise InputError for the first point outside the reference image, or moved by more than its diagonal."""
    is_finite = np.isfinite(given.points).all(axis=1) & np.isfinite(given.displacement).all(axis=1)
    if not is_finite.all():
        number = int(np.flatnonzero(~is_finite)[0])
        raise InputError(f"{given.describe_point(number)}: holds a value that is not finite; leave the point out")
    edge = np.array(extent.sizes) - 0.5
    is_inside = (given.points >= -0.5).all(axis=1) & (given.points <= edge).all(axis=1)
    if not is_inside.all():
        number = int(np.flatnonzero(~is_inside)[0])
        place = ", ".join(f"{coordinate:g}" for coordinate in given.points[number])
        raise InputError(f"{given.describe_point(number)}: ({place}) lies outside the reference image of "
                         f"{extent.describe()} px; give x (column) and y (row) in pixels")
    # Not by squares: what was meant as a number may be 1e308.
    lengths = np.hypot.reduce(given.displacement, axis=1)
    farthest = int(lengths.argmax())
    if lengths[farthest] > np.linalg.norm(extent.sizes):
        raise InputError(f"{given.describe_point(farthest)}: moves by {lengths[farthest]:g} px, out of the image of "
                         f"{extent.describe()} px; give displacements in pixels")


def require_points_inside(given: StartPoints, mesh: Mesh) -> None:
    """Refuse, with an InputError, points none of which lies in the region."""
    if (locate(mesh, given.points).cells < 0).all():
        raise InputError(f"{given.name}: none of {len(given.points)} points lies in the mesh; give one at least that "
                         "does, pixels of the reference image")

"""What a measurement is made from: cameras with their reference images, a mesh, and a case's settings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from ddic.case.frame_files import choose_frame, list_deformed
from ddic.case.loader import LoadedCase
from ddic.case.schema import Case
from ddic.errors import DdicError, InputError, as_collective, is_collective
from ddic.io.file_stamps import FileStamps
from ddic.kinematics.kinematics import RegionKinematics
from ddic.mesh.mesh import Mesh
from ddic.parallel.team import Team
from ddic.partition.ties import Tying
from ddic.problem.cameras import Camera, Frame, open_cameras, open_frame, open_on_all_ranks
from ddic.problem.mesh_source import build_meshes
from ddic.problem.rectangle import Rectangle, find_rectangle_of_case
from ddic.problem.solver_choice import SolverChoice
from ddic.problem.updated_reference import UpdatedReference


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
        Gives the whole mesh, and how near fields' own meshes are tied in it (None where there are none); called on
        rank 0 only.
    choose_kinematics : callable, optional
        From the whole mesh to its kinematics, called on rank 0 only; None for displacements of nodes.
    case_path : Path
        The case file; empty where there is none.
    case_text : str
        Its content; empty where there is none.
    notes : tuple of str
        What the user should know of how the case was completed.
    rectangle : Rectangle, optional
        What is measured where the case has [pgd]; ``build_mesh`` is not called then.
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
    rectangle: Rectangle | None = None
    n_frames: int = 1
    choice: SolverChoice | None = None
    updated: UpdatedReference | None = None

    def with_frame(self, number: int) -> Inputs:
        """Give the inputs of one frame of a series.

        Parameters
        ----------
        number : int
            Of the frame, from 0.

        Returns
        -------
        Inputs
            With its images in the case.
        """
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

    Parameters
    ----------
    team : Team
        All ranks.
    loaded : LoadedCase
        The case file.
    number : int, optional
        Of the frame of a series, from 0; the first by default.

    Returns
    -------
    inputs : Inputs
        With the reference images.
    frame : Frame
        The deformed images.

    Raises
    ------
    InputError
        On all ranks, where an image or a mapping cannot be read.
    """
    case = loaded.case
    opener = open_on_all_ranks(team)
    cameras = open_cameras(case, opener)
    image = cameras[0].reference.image
    inputs = Inputs(case, cameras, lambda: build_meshes(case, image.width, image.height),
                    case_path=loaded.path, case_text=loaded.text,
                    rectangle=None if case.pgd is None else find_rectangle_of_case(case),
                    n_frames=len(list_deformed(case.images)))
    return inputs, open_frame(case, opener, number)


@contextmanager
def inputs_kept(team: Team, stamps: FileStamps) -> Iterator[None]:
    """Refuse what the block finds where its inputs were not the same from their check to its end; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    stamps : FileStamps
        Of the inputs when they were checked.

    Yields
    ------
    None
        While they are read.

    Raises
    ------
    InputError
        On all ranks, with a line for each file that has changed or vanished, in place of what the block raises.
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

"""Measuring from Python: a case, a file, or images and a mesh in memory; alone or under mpirun."""

from __future__ import annotations

import copy
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from ddic.api.given import (
    ARGUMENTS,
    Arguments,
    ChooseKinematics,
    ImageLike,
    StartLike,
    check_kinematics,
    choose_team,
    convert_given_mesh,
    convert_start,
    is_mesh_named,
    load_given_case,
    make_case,
    make_image,
    open_given_image,
    sort_arguments,
)
from ddic.case.loader import LoadedCase, list_unused_keys
from ddic.case.methods import find_method
from ddic.case.named_files import list_cameras
from ddic.case.own_outputs import check_nothing_is_overwritten, check_output_file
from ddic.case.schema import Case
from ddic.check.case import check_mesh
from ddic.check.ranks import check_most_ranks, check_ranks
from ddic.errors import ConvergenceError, DdicError, InputError, Problems
from ddic.images.grey_levels import find_saturation
from ddic.images.source import ImageSource
from ddic.images.sub_image import MaskedSource
from ddic.inputs.cameras import Camera, Frame, make_first_camera
from ddic.inputs.inputs import Inputs, open_inputs
from ddic.inputs.mesh_source import accept_mesh, build_meshes, convert_mapping
from ddic.io.input_file import as_path
from ddic.io.result_reader import Result
from ddic.mesh.mesh import Mesh
from ddic.methods.fe_dic import is_line_wanted
from ddic.methods.method import MethodSession, prepare_session
from ddic.methods.run import keep_failed_run, remove_failed_field
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.partition.ties import Tying
from ddic.results.console import RunConsole
from ddic.results.listener import Silence
from ddic.results.publishing import Publishable, gather, publish
from ddic.start.given_start import GivenStart

if TYPE_CHECKING:
    from mpi4py import MPI

    from ddic.api.given import MeshLike


FRAMES = 10
"""Frames that a prepared session is expected to measure, where ``solver.frames`` does not say it."""


class Session:
    """A reference image prepared once, for any number of deformed images; use it in a ``with`` statement.

    ``ddic.prepare`` makes it. Every call is collective.

    Parameters
    ----------
    team : Team
        All ranks.
    inputs : Inputs
        Reference images, mesh and settings.
    progress : bool
        Whether rank 0 prints what ``ddic run`` prints while it goes on.
    """

    def __init__(self, team: Team, inputs: Inputs, progress: bool = False) -> None:
        self._team, self._inputs = team, inputs
        self._console = RunConsole() if progress and team.is_root else None
        self._session: MethodSession | None = prepare_session(team, inputs, self._console or Silence(),
                                                              PhaseClock(waiting=team.waiting))
        # Unknowns of the last field alone: its images would stay in memory.
        self._last: Any = None

    def __repr__(self) -> str:
        state = "closed" if self._session is None else "prepared"
        return f"<ddic.Session of {self._inputs.cameras[0].reference.image.path}: {state}>"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def n_assembled(self) -> int:
        """Times that this rank assembled M of a subdomain."""
        return self._require_open().n_assembled

    @property
    def n_factorized(self) -> int:
        """Operators that this rank factorised."""
        return self._require_open().n_factorized

    def measure(self, deformed: ImageLike | Sequence[ImageLike], *, from_last: bool = False,
                start: StartLike | None = None, output: str | Path | None = None) -> Result:
        """Measure the displacement between the reference image and a deformed one.

        Images do not depend on those before them, but for the weights of several cameras, which the first one gives,
        and for a plastic material (``yield_strain``), whose history they are, in the order of the calls.

        Parameters
        ----------
        deformed : Image, (height, width) array, str or Path
            As large as the reference image; a sequence with one of each camera where a case has several.
        from_last : bool
            Start from the last field that this session measured, as it is, instead of searching for one.
        start : Result or pair of (n, 2) arrays, optional
            A displacement to start from: an earlier result, or points and their displacement, pixels of the reference
            image. Where the images do not bear it out, the search goes on from it.
        output : str or Path, optional
            Result file to write as well; none by default.

        Returns
        -------
        Result
            Fields as arrays, on every rank; displacement in pixels.

        Raises
        ------
        InputError, ConvergenceError, SingularSubdomainError
            On all ranks; the session can measure other images afterwards. The second has the last field as ``result``,
            which is written as well where there is an output, under a name that says so.
        """
        images = self._team.together(lambda: self._check_images(deformed, from_last=from_last, start=start))
        given = self._convert_start(start)
        frame = self._open_frame(images)
        path = None if output is None else self._team.on_root(lambda: self._check_output(output, frame))
        return self._measure_frame(frame, self._last if from_last else given, path)

    def close(self) -> None:
        """Free the factors; what was measured stays."""
        if self._session is not None:
            self._session.close()
        self._session = None
        self._last = None
        if self._console is not None:
            self._console.stop()

    def _require_open(self) -> MethodSession:
        if self._session is None:
            raise InputError("session: it is closed; measure inside its with statement, or prepare another")
        return self._session

    def _measure_frame(self, frame: Frame, start: Any, output: Path | None) -> Result:
        """Measure a frame, and publish it; a last field that did not converge is kept."""
        # The earlier result that every frame starts from stays.
        earlier = self._inputs.case.start.from_result
        try:
            measured = self._require_open().measure(frame, start)
            self._last = measured.unknowns
            if output is not None:
                publish(measured, output, flip_y=self._inputs.case.output.flip_y)
                remove_failed_field(self._team, output, earlier)
            return gather(measured)
        except DdicError as error:
            keep_failed_run(self._team, error, output, earlier)
            if isinstance(error, ConvergenceError):
                last, error.last = error.last, None
                if isinstance(last, Publishable):
                    error.result = gather(last)
            raise

    def _open_frame(self, images: Sequence[ImageLike]) -> Frame:
        """Open a deformed image of each camera; collective."""
        cameras = self._inputs.cameras
        names = ["deformed image"] if len(cameras) == 1 else [f"deformed image, {camera.label}" for camera in cameras]
        complete = [make_image(image, section, section.deformed_mask)
                    for image, section in zip(images, list_cameras(self._inputs.case), strict=True)]
        return tuple(self._open_deformed(image, camera, name)
                     for image, camera, name in zip(complete, cameras, names, strict=True))

    def _convert_start(self, start: StartLike | None) -> GivenStart | None:
        return self._team.alike(lambda: convert_start(self._team, start, self._inputs.cameras[0].reference))

    def _check_images(self, deformed: ImageLike | Sequence[ImageLike], *, from_last: bool,
                      start: StartLike | None) -> Sequence[ImageLike]:
        """Check what can be told before images are opened; one image of each camera."""
        self._require_open()
        n_cameras = len(self._inputs.cameras)
        if from_last and self._last is None:
            raise InputError("from_last: this session has measured nothing yet")
        if from_last and start is not None:
            raise InputError("from_last and start: give one of them")
        if n_cameras == 1:
            return [deformed]  # type: ignore[list-item]  # of another type it is refused where it is opened
        if not isinstance(deformed, list | tuple) or len(deformed) != n_cameras:
            raise InputError(f"deformed images: give a list of {n_cameras}, one of each camera, the far one first")
        return deformed

    def _open_deformed(self, given: Any, camera: Camera, name: str) -> MaskedSource:
        image = open_given_image(self._team, given, name, dim=self._inputs.case.dim)
        self._team.together(lambda: _check_same_size(image, camera.reference, name))
        return replace(image, saturated_from=self._find_saturation(image, camera.reference))

    def _find_saturation(self, image: MaskedSource, reference: MaskedSource) -> float | None:
        """Grey level from which on a deformed image's pixels are left out: at most its reference image's."""
        if reference.saturated_from is None:
            return image.saturated_from
        found = image.saturated_from or self._team.together(lambda: find_saturation(image.image))
        return reference.saturated_from if found is None else min(found, reference.saturated_from)

    def _check_output(self, output: str | Path, frame: Frame) -> Path:
        """Check before measuring that a result can be written; returns its path."""
        path = as_path(output, "output")
        check_output_file(path)
        images = [image.image.path for image in (*(camera.reference for camera in self._inputs.cameras), *frame)]
        of_case = [self._inputs.case_path] if self._inputs.case_text else []
        check_nothing_is_overwritten(path, self._inputs.case, [*images, *of_case], "output")
        return path


def _check_same_size(image: MaskedSource, reference: MaskedSource, name: str) -> None:
    found, wanted = image.extent, reference.extent
    if found != wanted:
        raise InputError(f"{name}: {found.describe()} px, but the reference image has {wanted.describe()} px; give "
                         "images of one size")


def measure(source: str | Path | Case | LoadedCase | Sequence[ImageLike] | None = None,
            mesh: MeshLike | str | Path | Mapping[str, Any] | None = None, *,
            start: StartLike | Mapping[str, Any] | None = None, output: str | Path | Mapping[str, Any] | None = None,
            kinematics: ChooseKinematics | None = None, comm: MPI.Comm | None = None, progress: bool = False,
            **sections: Any) -> Result:
    """Measure the displacement between two images; collective under mpirun.

    Every section of a case file is an argument of the same name, and its keys are the same:
    ``measure(images, mesh, regularization={"cut_off_wavelength": 60})``. Where a key names a file, what is in memory
    may stand in its place.

    Parameters
    ----------
    source : str, Path, Case, LoadedCase or pair of images, optional
        A case file, a case, or the reference image and the deformed one: arrays (height, width), files or ``Image``.
        The section ``images`` may name them in its place.
    mesh : Mesh, meshio.Mesh, tuple of arrays, str, Path or mapping, optional
        With a pair of images: the mesh in pixels, as a tuple (nodes (n_nodes, 2), cells (n_cells, 3 or 4)); a mesh
        file; or the section ``mesh``, whose ``file`` may be any of these.
    start : Result, pair of (n, 2) arrays or mapping, optional
        A displacement to start from, in place of what a case says: an earlier result, or points and their displacement,
        pixels of the reference image; or the section ``start``, whose ``from_result`` and ``from_points`` may be these.
        Where the images do not bear it out, the search goes on from it.
    output : str, Path or mapping, optional
        Result file to write as well, or the section ``output``; none by default, also where a case names one.
    kinematics : callable, optional
        From the mesh to its kinematics; by default the unknowns are the displacements of the nodes.
    comm : mpi4py.MPI.Comm, optional
        The ranks that measure together; by default all that were started.
    progress : bool, optional
        Whether to print, in a notebook too, what ``ddic run`` prints while it goes on.
    **sections
        Other sections and keys of a case file, for a pair of images: ``regularization``, ``solver``, ``title``, ...

    Returns
    -------
    Result
        Fields as arrays, on every rank; displacement in pixels.

    Raises
    ------
    InputError, ConvergenceError, SingularSubdomainError
        On all ranks; the second has the last field, not converged, as ``result``.
    """
    team = choose_team(comm)
    given = team.together(lambda: sort_arguments(sections, mesh=mesh, start=start, output=output,
                                                 kinematics=kinematics, comm=comm))
    if isinstance(source, str | Path | Case | LoadedCase):
        inputs, frame = _open_case(team, source, given)
        with Session(team, inputs, progress) as session:
            return session._measure_frame(frame, session._convert_start(given.start), given.output)
    reference, deformed = team.together(lambda: _pair(source, given))
    with _prepare(team, reference, given, 1, progress) as session:
        return session.measure(deformed, start=given.start, output=given.output)


def prepare(source: ImageLike | Case | LoadedCase | None = None,
            mesh: MeshLike | str | Path | Mapping[str, Any] | None = None, *,
            kinematics: ChooseKinematics | None = None, comm: MPI.Comm | None = None, progress: bool = False,
            **sections: Any) -> Session:
    """Prepare a reference image for any number of deformed ones; collective under mpirun.

    Parameters
    ----------
    source : Image, (height, width) array, str, Path, Case or LoadedCase, optional
        The reference image, of which an array is copied; or a case, or a case file whose name ends in .toml. The
        section ``images`` may name the reference image in its place.
    mesh : Mesh, meshio.Mesh, tuple of arrays, str, Path or mapping, optional
        With an image: as ``measure`` takes it.
    kinematics : callable, optional
        From the mesh to its kinematics; by default the unknowns are the displacements of the nodes.
    comm : mpi4py.MPI.Comm, optional
        The ranks that measure together; by default all that were started.
    progress : bool, optional
        Whether to print, in a notebook too, what ``ddic run`` prints while it goes on.
    **sections
        Other sections and keys of a case file, for an image.

    Returns
    -------
    Session
        M, factors and coarse space, to be used in a ``with`` statement.

    Raises
    ------
    InputError, SingularSubdomainError
        On all ranks.
    """
    team = choose_team(comm)
    given = team.together(lambda: sort_arguments(
        sections, mesh=mesh, start=sections.get("start"), output=sections.get("output"), kinematics=kinematics,
        comm=comm))
    team.together(lambda: _refuse_what_frames_are_given(given))
    if isinstance(source, Case | LoadedCase) or (isinstance(source, str | Path) and Path(source).suffix == ".toml"):
        inputs, _ = _open_case(team, source, given)
        return Session(team, replace(inputs, n_frames=FRAMES), progress)
    return _prepare(team, given.reference if source is None else source, given, FRAMES, progress)


def _refuse_what_frames_are_given(given: Arguments) -> None:
    frames = {"images.deformed": given.deformed, "start": given.start, "output.file": given.output}
    for name, value in frames.items():
        if value is not None:
            raise InputError(f"{name}: a session is prepared once for many images; give it to session.measure, of each")


def _prepare(team: Team, source: Any, given: Arguments, n_frames: int, progress: bool) -> Session:
    """A session of a reference image for as many frames as are expected; collective."""
    # What the ranks were given is looked at by all together: it may be wrong on one of them alone.
    loaded, mesh = team.together(lambda: _look(team, given, source))
    images = loaded.case.imaging
    # Of more frames than one some are measured after this call, by when the user may have written into arrays.
    keeps = n_frames > 1
    reference = open_given_image(team, make_image(source, images, images.reference_mask), "reference image",
                                 images.masked, dim=loaded.case.dim, keeps=keeps)
    camera = make_first_camera(reference, images.noise)
    if keeps and is_line_wanted(loaded.case):
        # The first frame says where the line is, and the mesh waits for it.
        mesh = copy.deepcopy(mesh)
    if mesh is None:
        team.build_on_root(lambda: _check_said_mesh(loaded, reference.image, team.size))

    def build() -> tuple[Mesh, Tying | None]:
        if mesh is None:
            return loaded.kept_mesh.take(loaded.case) or build_meshes(loaded.case, reference.image.extent)
        whole = accept_mesh(mesh, "mesh", reference.image.extent)
        check_mesh(loaded, whole, team.size)
        return whole, None

    return Session(team, Inputs(loaded.case, (camera,), build, check_kinematics(given.kinematics), given_mesh=mesh,
                                n_frames=n_frames), progress)


def _look(team: Team, given: Arguments, reference: Any) -> tuple[LoadedCase, Mesh | None]:
    """What was given beside images, looked at; free of communication."""
    case = make_case(given.sections, reference)
    if given.mesh is None and not is_mesh_named(given.sections):
        raise InputError("mesh: none is given; ddic.structured_mesh makes one, meshio reads one (under mpirun give "
                         "it on every rank)")
    if given.mesh is not None and is_mesh_named(given.sections):
        raise InputError("mesh.structured stands for the mesh; leave one of them out")
    loaded = LoadedCase(case, ARGUMENTS, "")
    check_ranks(loaded, team.size)
    if team.is_root:
        for line in list_unused_keys(case):
            warnings.warn(f"{ARGUMENTS}: {line}", UserWarning, stacklevel=2)
    if given.mesh is None:
        return loaded, None
    return loaded, convert_given_mesh(given.mesh, convert_mapping(case.mesh.mapping), case.dim)


def _check_said_mesh(loaded: LoadedCase, reference: ImageSource, n_ranks: int) -> None:
    """Check the mesh that sections say, and what refers to it, as that of a case file."""
    problems = Problems()
    report = find_method(loaded.case).check(loaded, reference, None, problems)
    problems.require_none()
    check_most_ranks(loaded, report.most_ranks, n_ranks)


def _open_case(team: Team, source: object, given: Arguments) -> tuple[Inputs, Frame]:
    """Open what a case or a case file names; collective."""
    team.together(lambda: _refuse_beside_a_case(given))
    # A name that can be written, where nothing is: what a case names is looked at only if it is used.
    file = Path(tempfile.gettempdir()) / "ddic-writes-nothing.vtkhdf"
    file = file if given.output is None else given.output.resolve()
    inputs, frame = open_inputs(team, team.on_root(lambda: load_given_case(source, Path(), team.size, file)))
    return replace(inputs, choose_kinematics=check_kinematics(given.kinematics)), frame


def _refuse_beside_a_case(given: Arguments) -> None:
    if given.sections or any(value is not None for value in (given.mesh, given.reference, given.deformed)):
        raise InputError("a case says its mesh and settings itself: leave them out, or give a pair of images in its "
                         "place")


def _pair(source: object, given: Arguments) -> tuple[Any, Any]:
    """The reference image and the deformed one, from the first argument or from the section of images."""
    named = {"images.reference": given.reference, "images.deformed": given.deformed}
    for name, image in named.items():
        if source is not None and image is not None:
            raise InputError(f"{name}: images are the first argument, too; leave one of them out")
        if source is None and image is None:
            raise InputError(f"{name}: this key is missing; give a case file, a pair of images, or images=dict(...)")
    if source is None and isinstance(given.deformed, list | tuple) and all(isinstance(file, str | Path)
                                                                           for file in given.deformed):
        raise InputError("images.deformed: several images; run a case file, or prepare a session and measure each")
    if source is None:
        return given.reference, given.deformed
    if isinstance(source, Mapping):
        raise InputError("images: a mapping is given; give the sections of a case as arguments, ddic.measure(**case)")
    if not isinstance(source, list | tuple | np.ndarray):
        raise InputError(f"images: {type(source).__name__} given; give a case file, a case or a pair (reference image, "
                         "deformed image)")
    if isinstance(source, np.ndarray) and source.ndim < 3:
        raise InputError("images: one array is given, a pair expected: (reference image, deformed image)")
    if len(source) != 2:
        raise InputError(f"images: {len(source)} are given, two expected: the reference image and the deformed one")
    return source[0], source[1]

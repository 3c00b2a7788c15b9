"""Measuring from Python: a case, a file, or images and a mesh in memory; alone or under mpirun."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from mpi4py import MPI
from pydantic import ValidationError

from ddic.api.image import ImageLike, open_given_image
from ddic.api.mesh import convert_given_mesh
from ddic.case.loader import LoadedCase, load_case
from ddic.case.messages import describe
from ddic.case.schema import Case
from ddic.errors import InputError
from ddic.images.camera import identity
from ddic.io.result_reader import Result
from ddic.kinematics.kinematics import RegionKinematics
from ddic.mesh.mesh import Mesh
from ddic.methods.dd_dic import Session as RecipeSession
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.problem.cameras import Camera, Frame, make_setup
from ddic.problem.check_inputs import check_inputs
from ddic.problem.check_mesh_uses import check_wavelength
from ddic.problem.check_ranks import check_ranks
from ddic.problem.inputs import Inputs, open_inputs
from ddic.problem.mesh_source import accept_mesh
from ddic.results.listener import Silence
from ddic.results.measurement import Measurement
from ddic.results.publishing import Destination, gather, publish

if TYPE_CHECKING:
    import meshio

ChooseKinematics = Callable[[Mesh], RegionKinematics]
"""From the whole mesh, repaired, to its kinematics."""

_NO_PATH = "in memory"
_RESERVED = ("mesh", "near", "output")
"""Sections of a case file that arguments stand for, or that need files."""


@dataclass(frozen=True, eq=False)
class Options:
    """How to measure.

    Attributes
    ----------
    settings : mapping
        Sections and keys of a case file, such as ``{"regularization": {"cut_off_wavelength": 60}}``.
    kinematics : callable, optional
        From the mesh to its kinematics; by default the unknowns are the displacements of the nodes.
    comm : mpi4py.MPI.Comm, optional
        The ranks that measure together; by default all that were started.
    """

    settings: Mapping[str, Any]
    kinematics: ChooseKinematics | None = None
    comm: MPI.Comm | None = None

    @property
    def team(self) -> Team:
        """The ranks."""
        return Team.world() if self.comm is None else Team(self.comm)


class Session:
    """A reference image prepared once, for any number of deformed images; use it in a ``with`` statement.

    ``ddic.prepare`` makes it. Every call is collective.
    """

    def __init__(self, team: Team, inputs: Inputs) -> None:
        self._team, self._inputs = team, inputs
        self._session = RecipeSession(team, inputs, Silence(), PhaseClock(waiting=team.waiting))
        self._last: Measurement | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    @property
    def n_assembled(self) -> int:
        """Times that this rank assembled M of a subdomain."""
        return self._session.problem.n_assembled

    @property
    def n_factorized(self) -> int:
        """Operators that this rank factorised."""
        return self._session.problem.solver.n_factorized

    def measure(self, deformed: ImageLike, *, from_last: bool = False, output: str | Path | None = None) -> Result:
        """Measure the displacement between the reference image and a deformed one.

        Parameters
        ----------
        deformed : Image, (height, width) array, str or Path
            As large as the reference image.
        from_last : bool
            Start from the last field that this session measured instead of searching for one.
        output : str or Path, optional
            Result file to write as well; none by default.

        Returns
        -------
        Result
            Fields as arrays, on every rank; displacement in pixels.

        Raises
        ------
        InputError, ConvergenceError, SingularSubdomainError
            On all ranks; the session can measure other images afterwards.
        """
        image = open_given_image(self._team, deformed, "deformed image")
        reference = self._inputs.cameras[0].reference
        if image.extent != reference.extent:
            found, wanted = image.extent, reference.extent
            raise InputError(f"deformed image: {found.width} x {found.height} px, but the reference image has "
                             f"{wanted.width} x {wanted.height} px; give images of one size")
        if from_last and self._last is None:
            raise InputError("from_last: this session has measured nothing yet")
        return self.measure_frame((image,), self._last if from_last else None, output)

    def measure_frame(self, frame: Frame, start: Measurement | None = None,
                      output: str | Path | None = None) -> Result:
        """Measure a frame of one image of each camera.

        Parameters
        ----------
        frame : tuple of MaskedSource
            Opened images, one of each camera.
        start : Measurement, optional
            Of an earlier frame, to start from.
        output : str or Path, optional
            Result file to write as well; none by default.

        Returns
        -------
        Result
            Fields as arrays, on every rank; displacement in pixels.
        """
        measurement = self._session.measure(frame, start)
        self._last = measurement
        if output is not None:
            publish(measurement, Destination(Path(output), self._inputs.case.output.flip_y))
        return gather(measurement)

    def close(self) -> None:
        """Free the factors."""
        self._session.close()


def measure(source: str | Path | Case | Sequence[ImageLike],
            mesh: Mesh | meshio.Mesh | tuple[Any, Any] | None = None, *,
            options: Options | Mapping[str, Any] | None = None, output: str | Path | None = None) -> Result:
    """Measure the displacement between two images; collective under mpirun.

    Parameters
    ----------
    source : str, Path, Case or pair of images
        A case file, a case, or the reference image and the deformed one: arrays (height, width), files or ``Image``.
    mesh : Mesh, meshio.Mesh or tuple of arrays, optional
        With a pair of images: the mesh in pixels, as a tuple (nodes (n_nodes, 2), cells (n_cells, 3 or 4)).
    options : Options or mapping, optional
        With a pair of images: sections and keys of a case file, or these with kinematics and a communicator.
    output : str or Path, optional
        Result file to write as well; none by default, also where a case names one.

    Returns
    -------
    Result
        Fields as arrays, on every rank; displacement in pixels.

    Raises
    ------
    InputError, ConvergenceError, SingularSubdomainError
        On all ranks.
    """
    if isinstance(source, str | Path | Case):
        if mesh is not None or options is not None:
            raise InputError("a case says its mesh and settings itself; give images instead, or leave these out")
        return _measure_case(source, output)
    reference, deformed = _pair(source)
    with prepare(reference, mesh, options=options) as session:
        return session.measure(deformed, output=output)


def prepare(reference: ImageLike, mesh: Mesh | meshio.Mesh | tuple[Any, Any] | None, *,
            options: Options | Mapping[str, Any] | None = None) -> Session:
    """Prepare a reference image for any number of deformed ones; collective under mpirun.

    Parameters
    ----------
    reference : Image, (height, width) array, str or Path
        The reference image.
    mesh : Mesh, meshio.Mesh or tuple of arrays
        Pixels; as a tuple (nodes (n_nodes, 2), cells (n_cells, 3 or 4)).
    options : Options or mapping, optional
        Sections and keys of a case file, or these with kinematics and a communicator.

    Returns
    -------
    Session
        M, factors and coarse space, to be used in a ``with`` statement.

    Raises
    ------
    InputError, SingularSubdomainError
        On all ranks.
    """
    if mesh is None:
        raise InputError("mesh: none is given; ddic.structured_mesh makes one, meshio reads one")
    chosen = options if isinstance(options, Options) else Options(options or {})
    team = chosen.team
    case = _make_case(chosen.settings)
    check_ranks(LoadedCase(case, Path("options"), ""), team.size)
    source = open_given_image(team, reference, "reference image")
    camera = Camera(0, source, make_setup(identity(), source, "none"), None)
    given = convert_given_mesh(mesh)

    def build() -> tuple[Mesh, None]:
        whole = accept_mesh(given, "mesh", source.image.width, source.image.height)
        check_wavelength(case, whole)
        return whole, None

    return Session(team, Inputs(case, (camera,), build, chosen.kinematics))


def _measure_case(source: str | Path | Case, output: str | Path | None) -> Result:
    team = Team.world()

    def load() -> LoadedCase:
        loaded = LoadedCase(source, Path(), "") if isinstance(source, Case) else load_case(Path(source))
        if output is not None:
            renamed = loaded.case.output.model_copy(update={"file": Path(output).resolve()})
            loaded = replace(loaded, case=loaded.case.model_copy(update={"output": renamed}))
        check_inputs(loaded)
        check_ranks(loaded, team.size)
        return loaded

    inputs, frame = open_inputs(team, team.on_root(load))
    with Session(team, inputs) as session:
        return session.measure_frame(frame, None, output)


def _pair(source: Sequence[ImageLike]) -> tuple[ImageLike, ImageLike]:
    if len(source) != 2:
        raise InputError(f"images: {len(source)} are given, two expected: the reference image and the deformed one")
    return source[0], source[1]


def _make_case(settings: Mapping[str, Any]) -> Case:
    """A case of these settings; what else a case file holds is in memory."""
    for name in _RESERVED:
        if name in settings:
            raise InputError(f"options: [{name}] is for case files; with images in memory give it as an argument, or "
                             "measure a case")
    data: dict[str, Any] = json.loads(json.dumps(dict(settings), default=str))
    images = {"reference": _NO_PATH, "deformed": _NO_PATH, **data.get("images", {})}
    data |= {"images": images, "mesh": {"file": _NO_PATH}}
    try:
        return Case.model_validate_json(json.dumps(data), strict=True)
    except ValidationError as error:
        raise InputError([f"options: {line}" for line in describe(error, data)]) from error

"""The cameras of a case: their reference images, where they look, and which cells each of them measures."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ddic.arrays import Array, BoolArray, IntArray
from ddic.case.named_files import list_cameras, list_deformed
from ddic.case.schema import Case, NearSection
from ddic.errors import InputError
from ddic.images.camera import CameraMapping, identity, similarity
from ddic.images.source import ImageSource
from ddic.images.sub_image import MaskedSource
from ddic.inputs.masks import Opener, exclude_from_reference, exclude_masked
from ddic.io.mapping_file import read_mapping_file
from ddic.io.volume_file import open_source
from ddic.kinematics.camera import CameraSetup, MotionKind, see_mesh
from ddic.mesh.mesh import Mesh
from ddic.parallel.node import open_once_a_node
from ddic.parallel.team import Team, require_held
from ddic.partition.split import assign_cameras
from ddic.partition.ties import Tying

Frame = tuple[MaskedSource, ...]
"""The deformed images of one instant, one of each camera."""


@dataclass(frozen=True)
class Camera:
    """A camera: its reference image, where it looks, and what the case says of it.

    Which cells it measures is said of near cameras alone: the first one measures what is left.

    Attributes
    ----------
    number : int
        0 the first, whose pixels are the specimen's frame.
    reference : MaskedSource
        Its reference image.
    setup : CameraSetup
        Where it looks, and how its set-up may move.
    noise : float or None
        Standard deviation of a picture's noise, grey levels; None if it is to be estimated.
    region : (x0, y0, x1, y1) or None
        Cells outside are left to the first camera, specimen's frame; None where it measures all that it sees whole.
    margin : float
        Width of the image's edge that does not count, the camera's pixels.
    has_own_mesh : bool
        Whether it measures the cells of a mesh of its own, and no others.
    use_far : bool
        Whether the first camera measures its cells as well.
    """

    number: int
    reference: MaskedSource
    setup: CameraSetup
    noise: float | None
    region: tuple[float, float, float, float] | None = None
    margin: float = 0.0
    has_own_mesh: bool = False
    use_far: bool = False

    @property
    def label(self) -> str:
        """What the log calls it."""
        return "far field" if self.number == 0 else f"near field {self.number}"

    @property
    def entry(self) -> str:
        """What messages about the case file call a near camera."""
        return f"near, entry {self.number}"


def open_on_all_ranks(team: Team, dim: int) -> Opener:
    """Give what opens images, or where ``dim`` is 3 volumes, on all ranks.

    One that can only be decoded whole is decoded once a node. What it gives is collective: ranks open the same images
    in the same order.
    """
    return lambda path: open_once_a_node(team, lambda: open_source(path, dim))


def open_cameras(case: Case, opener: Opener) -> tuple[Camera, ...]:
    """Open the reference images of a case with absolute paths: the far camera, then the near ones.

    Raises InputError where a file or a mapping cannot be read, or a mapping is none.
    """
    far = exclude_from_reference(opener(case.imaging.reference), case.imaging, opener)
    cameras = [make_first_camera(far, case.imaging.noise)]
    for number, section in enumerate(case.near, start=1):
        reference = exclude_from_reference(opener(section.reference), section, opener)
        try:
            setup = _make_setup(_mapping(section, far.image, reference.image), reference, section.motion)
        except ValueError as error:
            raise InputError(f"near, entry {number}: {error}; check its mapping (ddic calibrate)") from error
        cameras.append(Camera(number, reference, setup, section.noise, section.region, section.margin,
                              has_own_mesh=section.mesh is not None, use_far=section.use_far))
    return tuple(cameras)


def make_first_camera(reference: MaskedSource, noise: float | None) -> Camera:
    """Make the camera whose pixels are the specimen's frame; ``noise`` is that of a picture, grey levels."""
    dim = len(reference.extent.sizes)
    setup = _make_setup(identity(), reference, "none") if dim == 2 else CameraSetup(None, "none", np.zeros(dim), 1.0)
    return Camera(0, reference, setup, noise)


def open_frame(case: Case, opener: Opener, number: int = 0) -> Frame:
    """Open the deformed images of a case with absolute paths, one of each camera.

    ``number`` is that of the frame of a series, from 0. Raises InputError where a file cannot be read.
    """
    return tuple(exclude_masked(opener(list_deformed(section)[number]), section, section.deformed_mask, opener)
                 for section in list_cameras(case))


def _make_setup(mapping: CameraMapping, reference: MaskedSource, motion: MotionKind) -> CameraSetup:
    """Describe a camera's set-up by its mapping and the size of its image: it turns about the middle of what it sees.

    ``mapping`` leads from the specimen's frame to the camera's pixels, ``motion`` is how the set-up may move.
    """
    corners = reference.image.extent.corners
    seen = mapping.to_specimen(corners)
    centre = mapping.to_specimen(corners.mean(axis=0, keepdims=True))[0]
    farthest = float(np.linalg.norm(seen - centre, axis=1).max())
    return CameraSetup(mapping, motion, centre, farthest)


def _mapping(section: NearSection, far: ImageSource, near: ImageSource) -> CameraMapping:
    if section.mapping_file is not None:
        content = read_mapping_file(section.mapping_file)
        for key, size, image in (("far_size", content.far_size, far), ("near_size", content.near_size, near)):
            if size != (image.width, image.height):
                raise InputError(f"{section.mapping_file}: images.{key} = {list(size)}, but {image.path} is "
                                 f"{image.width} x {image.height} px: the mapping is that of other images; make it "
                                 "from these by ddic calibrate")
        return content.mapping
    return similarity(require_held(section.ratio), section.rotation_degrees, require_held(section.offset))


def assign_cells(cameras: Sequence[Camera], mesh: Mesh, tying: Tying | None = None) -> IntArray:
    """Assign each cell to the camera that measures it: the camera's number, (n_cells,).

    ``tying`` is that of near fields' own meshes in the whole one, None without. Raises InputError where a near camera
    sees no whole element, or leaves none to the far one, or does not see its own mesh.
    """
    near = cameras[1:]
    seen = [_sees(camera, mesh.nodes) for camera in near]
    if tying is not None:
        for camera, sees in zip(near, seen, strict=True):
            _check_own_mesh(camera, mesh, tying, sees)
        seen = [np.zeros_like(sees) if camera.has_own_mesh else sees for camera, sees in zip(near, seen, strict=True)]
    labels = assign_cameras(mesh, seen)
    if tying is not None:
        labels = np.where(tying.cameras > 0, tying.cameras, labels)
    for camera in near:
        if not (labels == camera.number).any():
            raise InputError(f"{camera.entry}: its images see no whole element of the mesh; check its mapping "
                             f"(ddic calibrate), near.region and near.margin, or use smaller elements")
    if not (labels == 0).any():
        raise InputError("near: the near-field images see every element, which leaves none to the far-field images; "
                         "measure with the near-field images alone, or give near.region")
    return labels


def _check_own_mesh(camera: Camera, mesh: Mesh, tying: Tying, sees: BoolArray) -> None:
    """Raise InputError where a near camera does not see all of its own mesh; sees: (n_nodes,)."""
    part, nodes = mesh.create_submesh(np.flatnonzero(tying.cameras == camera.number))
    hidden = part.nodes[~sees[nodes]]
    if len(hidden):
        raise InputError(f"{camera.entry}: its images do not show all of near.mesh, for instance column "
                         f"{hidden[0, 0]:.0f}, row {hidden[0, 1]:.0f}; use a smaller mesh, or a smaller margin")


def _sees(camera: Camera, nodes: Array) -> BoolArray:
    """Whether nodes (n, 2), specimen's frame, lie in a near image, its margin left out, and in its region."""
    image = camera.reference.image
    try:
        seen = camera.setup.to_image(nodes)
    except ValueError:
        # Beyond the horizon of the mapping.
        return np.zeros(len(nodes), dtype=bool)
    low = camera.margin
    high = np.array([image.width - 1, image.height - 1]) - camera.margin
    inside = ((seen >= low) & (seen <= high)).all(axis=1)
    if camera.region is not None:
        x0, y0, x1, y1 = camera.region
        inside &= ((nodes >= (x0, y0)) & (nodes <= (x1, y1))).all(axis=1)
    return np.asarray(inside)


@dataclass(frozen=True)
class MeasuredCells:
    """The cells that one camera measures.

    Attributes
    ----------
    cells : (n,) array of int64
        Their numbers in the whole mesh.
    mesh, seen : Mesh
        Their mesh, in the specimen's frame and in the camera's pixels.
    """

    cells: IntArray
    mesh: Mesh
    seen: Mesh


def collect_measured_cells(cameras: Sequence[Camera], mesh: Mesh, labels: IntArray) -> list[MeasuredCells]:
    """Collect the cells of each camera; ``labels``, (n_cells,), give the camera of each cell."""
    if len(cameras) == 1:
        return [MeasuredCells(np.arange(mesh.n_cells), mesh, mesh)]
    collected = []
    for camera in cameras:
        cells = np.flatnonzero(labels == camera.number)
        part, _ = mesh.create_submesh(cells)
        collected.append(MeasuredCells(cells, part, see_mesh(part, camera.setup)))
    return collected

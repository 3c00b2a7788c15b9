"""The cameras of a case: their images, where they look, and which elements each of them measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.case.schema import Case, NearSection
from ddic.errors import InputError
from ddic.images.camera import CameraMapping, identity, similarity
from ddic.images.source import ImageSource
from ddic.io.image_file import open_decoded, open_image
from ddic.io.mapping_file import read_mapping
from ddic.kinematics.pose import Motion, Rig
from ddic.mesh.mesh import Mesh
from ddic.parallel.shared_image import open_once_a_node
from ddic.parallel.team import Team
from ddic.partition.by_camera import camera_of_cells
from ddic.partition.ties import Tying
from ddic.problem.inputs import ImagePair, pair_of


@dataclass(frozen=True)
class Camera:
    """A camera: its images, where it looks, and what the case says of its noise.

    noise: standard deviation of a picture's grey levels, None if it is to be estimated.
    """

    pair: ImagePair
    rig: Rig
    noise: float | None


def open_cameras(case: Case) -> tuple[Camera, ...]:
    """The far camera and the near ones (headers only); raises InputError."""
    return _cameras(case, open_image)


def open_shared_cameras(team: Team, case: Case) -> tuple[Camera, ...]:
    """``open_cameras`` on all ranks: an image that can only be decoded whole is decoded once a node; collective."""
    return _cameras(case, lambda path: open_once_a_node(team, lambda: open_decoded(path)))


def measured_by(case: Case, cameras: tuple[Camera, ...], mesh: Mesh, tying: Tying | None = None) -> NDArray[np.int64]:
    """Number of the camera that measures each cell, (n_cells,).

    tying: of near fields' own meshes in the whole one, None without. Raises InputError where a near camera sees no
    whole element, or leaves none to the far one, or does not see its own mesh.
    """
    seen = [_sees(section, camera, mesh.nodes) for section, camera in zip(case.near, cameras[1:], strict=True)]
    if tying is not None:
        _check_own_meshes(mesh, tying, seen)
        seen = [s & (section.mesh is None) for section, s in zip(case.near, seen, strict=True)]
    labels = camera_of_cells(mesh, seen)
    if tying is not None:
        labels = np.where(tying.cameras > 0, tying.cameras, labels)
    for number in range(1, len(cameras)):
        if not (labels == number).any():
            raise InputError(f"{name_of(number)}: its images see no whole element of the mesh; check its mapping "
                             f"(ddic calibrate), near.region and near.margin, or use smaller elements")
    if not (labels == 0).any():
        raise InputError("near: the near-field images see every element, which leaves none to the far-field images; "
                         "measure with the near-field images alone, or give near.region")
    return labels


def _check_own_meshes(mesh: Mesh, tying: Tying, seen: list[NDArray[np.bool_]]) -> None:
    """Raise InputError where a near camera does not see all of its own mesh; seen: of its camera, each (n_nodes,)."""
    for number, sees in enumerate(seen, start=1):
        part, nodes = mesh.submesh(np.flatnonzero(tying.cameras == number))
        hidden = part.nodes[~sees[nodes]]
        if len(hidden):
            raise InputError(f"{name_of(number)}: its images do not show all of near.mesh, for instance column "
                             f"{hidden[0, 0]:.0f}, row {hidden[0, 1]:.0f}; use a smaller mesh, or a smaller margin")


def _cameras(case: Case, opened: Callable[[Path], ImageSource]) -> tuple[Camera, ...]:
    far = pair_of(case.images, opened)
    cameras = [Camera(far, _rig(identity(), far, "none"), case.images.noise)]
    for number, section in enumerate(case.near, start=1):
        pair = pair_of(section, opened)
        try:
            rig = _rig(_mapping(section), pair, section.motion)
        except ValueError as error:
            raise InputError(f"{name_of(number)}: {error}; check its mapping (ddic calibrate)") from error
        cameras.append(Camera(pair, rig, section.noise))
    return tuple(cameras)


def name_of(number: int) -> str:
    """What messages call a near camera, from 1."""
    return f"near, entry {number}"


def _mapping(section: NearSection) -> CameraMapping:
    if section.mapping_file is not None:
        return read_mapping(section.mapping_file)
    assert section.ratio is not None
    assert section.offset is not None
    return similarity(section.ratio, section.rotation_degrees, section.offset)


def _rig(mapping: CameraMapping, pair: ImagePair, motion: Motion) -> Rig:
    width, height = pair.reference.image.width, pair.reference.image.height
    corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], dtype=np.float64)
    seen = mapping.to_specimen(corners)
    centre = mapping.to_specimen(corners.mean(axis=0, keepdims=True))[0]
    return Rig(mapping, motion, centre, float(np.linalg.norm(seen - centre, axis=1).max()))


def _sees(section: NearSection, camera: Camera, nodes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether nodes (n, 2), specimen's frame, lie in a near image, its margin left out, and in its region."""
    image = camera.pair.reference.image
    try:
        seen = camera.rig.mapping.to_image(nodes)
    except ValueError:
        return np.zeros(len(nodes), dtype=bool)
    low, high = section.margin, np.array([image.width - 1, image.height - 1]) - section.margin
    inside = ((seen >= low) & (seen <= high)).all(axis=1)
    if section.region is not None:
        x0, y0, x1, y1 = section.region
        inside &= ((nodes >= (x0, y0)) & (nodes <= (x1, y1))).all(axis=1)
    return np.asarray(inside)

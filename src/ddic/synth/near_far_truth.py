"""The truth file of a near-field and far-field pair: exact displacements in both cameras' pixels."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.camera import CameraMapping
from ddic.io.json_file import write_json
from ddic.synth.fields import DisplacementField
from ddic.synth.near_far_scene import NearFarScene, SetUpMotion
from ddic.synth.truth import as_tuples, describe_pair, load_truth, read_record

Built = TypeVar("Built")
_REMEDY = "give the truth.json that ddic synth near-far wrote"


@dataclass(frozen=True, eq=False)
class NearFarTruth:
    """What a near-field and far-field measurement should find.

    Attributes
    ----------
    field : DisplacementField
        u, specimen's frame, which is the far camera's pixels.
    mapping : CameraMapping
        phi, from there to the near camera's pixels.
    motion : SetUpMotion
        T, of the near set-up between its two pictures.
    near_size : (int, int)
        Width and height of the near image, pixels.
    """

    field: DisplacementField
    mapping: CameraMapping
    motion: SetUpMotion
    near_size: tuple[int, int]

    def displacement(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Evaluate the displacement u.

        Parameters
        ----------
        points : (n, 2) array
            X, pixels of the specimen's frame.

        Returns
        -------
        (n, 2) array
            Far pixels.
        """
        return self.field.displacement(points)

    def gradient(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Evaluate the gradient du_i/dX_j.

        Parameters
        ----------
        points : (n, 2) array
            X, pixels of the specimen's frame.

        Returns
        -------
        (n, 2, 2) array
            No unit.
        """
        return self.field.gradient(points)

    def near_displacement(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Evaluate phi(T(X + u(X))) - phi(X).

        Parameters
        ----------
        points : (n, 2) array
            X, pixels of the specimen's frame.

        Returns
        -------
        (n, 2) array
            Near pixels.
        """
        moved = self.motion.move(points + self.field.displacement(points))
        return np.asarray(self.mapping.to_image(moved) - self.mapping.to_image(points))

    def is_in_near_field(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Find which points the near reference image shows.

        Parameters
        ----------
        points : (n, 2) array
            X, pixels of the specimen's frame.

        Returns
        -------
        (n,) array of bool
            True where it does.
        """
        seen = self.mapping.to_image(points)
        largest = np.array(self.near_size) - 1
        return np.asarray(((seen >= 0) & (seen <= largest)).all(axis=1))


def save_near_far_truth(path: Path, scene: NearFarScene) -> None:
    """Write a truth file.

    Parameters
    ----------
    path : Path
        The truth file.
    scene : NearFarScene
        What was rendered.

    Raises
    ------
    InputError
        If the field is not one of this package's, or the folder cannot be written to.
    """
    write_json(path, describe_near_far(scene))


def describe_near_far(scene: NearFarScene) -> dict[str, Any]:
    """Describe fields, textures, holes, cameras and the set-up's motion, as values that JSON holds.

    The far pair is described as ``save_truth`` describes a pair, the near pair likewise under ``near``, where
    ``mapping`` is phi and ``motion`` is T; the displacement of both is the one of the specimen's frame.

    Parameters
    ----------
    scene : NearFarScene
        What was rendered.

    Returns
    -------
    dict
        A truth file's record.

    Raises
    ------
    InputError
        If the field is not one of this package's.
    """
    camera = scene.near.camera
    record = describe_pair(scene.far, scene.far_picture)
    of_near = describe_pair(scene.near.surface, camera.picture)
    record["near"] = {
        **{key: of_near[key] for key in ("texture", "hole", "image")},
        "mapping": _describe_mapping(camera.mapping),
        "motion": dataclasses.asdict(camera.motion),
    }
    return record


def _describe_mapping(mapping: CameraMapping) -> dict[str, Any]:
    """Arguments of CameraMapping as values that JSON holds."""
    return {
        "homography": mapping.homography.tolist(),
        "centre": mapping.centre.tolist(),
        "radius": mapping.radius,
        "radial": mapping.radial.tolist(),
    }


def load_near_far_truth(path: Path) -> NearFarTruth:
    """Rebuild the exact fields that a truth file of ``ddic synth near-far`` describes.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    NearFarTruth
        Exactly what made the images.

    Raises
    ------
    InputError
        If the file is missing, foreign, or has an impossible value; it names file and key.
    """
    field = load_truth(path)
    near = read_record(path).get("near")
    if not isinstance(near, dict):
        raise InputError(f"{path}: near: is missing; {_REMEDY}")
    mapping = _rebuild_near(path, near, "mapping", CameraMapping)
    motion = _rebuild_near(path, near, "motion", SetUpMotion)
    size = _rebuild_near(path, near, "image", lambda width, height, **_rest: (int(width), int(height)))
    return NearFarTruth(field, mapping, motion, size)


def _rebuild_near(path: Path, near: dict[str, Any], key: str, kind: Callable[..., Built]) -> Built:
    """Make an object of the values under a key of the near part; path: for errors."""
    values = near.get(key)
    if not isinstance(values, dict):
        raise InputError(f"{path}: near.{key}: is missing; {_REMEDY}")
    try:
        return kind(**{name: as_tuples(value) for name, value in values.items()})
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"{path}: near.{key}: {error}; {_REMEDY}") from error

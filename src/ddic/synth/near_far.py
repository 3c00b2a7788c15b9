"""A near-field and a far-field pair of one specimen, whose displacement and set-up are known exactly."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.camera import CameraMapping
from ddic.synth.digitise import Digitiser
from ddic.synth.fields import DisplacementField, Pair, require_finite
from ddic.synth.hole import Hole
from ddic.synth.render import Scene, write_images
from ddic.synth.two_scale_texture import TwoScaleTexture

FAR_FILES = ("far_reference.tif", "far_deformed.tif")
NEAR_FILES = ("near_reference.tif", "near_deformed.tif")

# The near pair's noise is drawn from other streams than the far pair's 0 and 1.
_NEAR_STREAM = 2


@dataclass(frozen=True)
class SetUpMotion:
    """Rigid motion T(Y) = centre + R(rotation) (Y - centre) + alpha of the near set-up between its two pictures.

    alpha: pixels of the specimen's frame; rotation_degrees: from x towards y; centre: X0, pixels of that frame.
    Raises InputError where a number is not finite.
    """

    alpha: Pair = (0.0, 0.0)
    rotation_degrees: float = 0.0
    centre: Pair = (0.0, 0.0)

    def __post_init__(self) -> None:
        require_finite("near set-up", alpha=self.alpha, rotation_degrees=self.rotation_degrees, centre=self.centre)

    def moved(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """T at points Y (n, 2), pixels."""
        return np.asarray((points - self.centre) @ self._rotation().T + self.centre + self.alpha)

    def unmoved(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """The Y (n, 2) with T(Y) = points (n, 2), pixels."""
        return np.asarray((points - self.centre - np.array(self.alpha)) @ self._rotation() + self.centre)

    def _rotation(self) -> NDArray[np.float64]:
        if self.rotation_degrees == 0:
            return np.eye(2)
        c, s = math.cos(math.radians(self.rotation_degrees)), math.sin(math.radians(self.rotation_degrees))
        return np.array([[c, -s], [s, c]])


@dataclass(frozen=True, eq=False)
class NearScene:
    """What the near camera looks at, in its own pixels.

    surface: texture, displacement u and hole in the specimen's frame; mapping: phi, from that frame to the camera's
    pixels; motion: T, of the set-up between the two pictures.
    """

    surface: Scene
    mapping: CameraMapping
    motion: SetUpMotion

    def reference_grey(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Grey level f_n at points (n, 2), near pixels, as fractions of full scale (n,)."""
        return self.surface.reference_grey(self.mapping.to_specimen(points))

    def deformed_grey(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Grey level g_n at points (n, 2), near pixels: f_n(phi(X)) = g_n(phi(T(X + u(X))))."""
        return self.surface.deformed_grey(self.motion.unmoved(self.mapping.to_specimen(points)))

    def displacement(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """phi(T(X + u(X))) - phi(X) at points phi(X) (n, 2) of the near reference image, near pixels (n, 2)."""
        specimen = self.mapping.to_specimen(points)
        moved = self.motion.moved(specimen + self.surface.field.displacement(specimen))
        return np.asarray(self.mapping.to_image(moved) - points)


@dataclass(frozen=True)
class Frame:
    """A camera's picture; width, height: pixels; digitiser: from grey levels to stored values."""

    width: int
    height: int
    digitiser: Digitiser

    @property
    def middle(self) -> Pair:
        """Position of the picture's centre, pixels."""
        return (self.width - 1) / 2, (self.height - 1) / 2

    @property
    def corners(self) -> NDArray[np.float64]:
        """Centres of the four corner pixels (4, 2)."""
        right, bottom = self.width - 1.0, self.height - 1.0
        return np.array([[0.0, 0.0], [right, 0.0], [right, bottom], [0.0, bottom]])


@dataclass(frozen=True, eq=False)
class NearFarScene:
    """One specimen and the two cameras that look at it; the far camera's pixels are the specimen's frame.

    Raises InputError where the near camera looks beyond the far picture.
    """

    far: Scene
    near: NearScene
    far_frame: Frame
    near_frame: Frame

    def __post_init__(self) -> None:
        try:
            corners = self.near.mapping.to_specimen(self.near_frame.corners)
        except ValueError as error:
            raise InputError(f"near camera: {error}; use a smaller tilt") from error
        limits = np.array([self.far_frame.width - 1, self.far_frame.height - 1])
        if not ((corners >= 0) & (corners <= limits)).all():
            (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
            raise InputError(
                f"near field: x {x0:.6g}..{x1:.6g}, y {y0:.6g}..{y1:.6g} px lies partly outside the far image, "
                f"x 0..{limits[0]}, y 0..{limits[1]} px; move its centre, use a larger ratio or a smaller near image")


def near_mapping(ratio: float, centre: Pair, frame: Frame, angle_degrees: float = 0.0,
                 tilt: Pair = (0.0, 0.0)) -> CameraMapping:
    """The near camera's phi: ``centre`` in the middle of its frame, magnified ``ratio`` times there.

    ratio: near pixels per far pixel, above 1; centre: X0, specimen's frame, pixels; angle_degrees: of the picture,
    from x towards y; tilt: how much farther, as a fraction, the specimen is at the middle of the right and of the
    lower edge of an upright near field than at its centre.
    Raises InputError for a ratio of 1 or less, or a number that is not finite.
    """
    require_finite("near camera", centre=centre, angle_degrees=angle_degrees, tilt=tilt)
    _require_ratio(ratio)
    c, s = ratio * math.cos(math.radians(angle_degrees)), ratio * math.sin(math.radians(angle_degrees))
    slope = np.array(tilt) * 2 * ratio / np.array([frame.width, frame.height])
    about_centre = np.array([[c, -s, 0.0], [s, c, 0.0], [slope[0], slope[1], 1.0]])
    homography = _shift(frame.middle) @ about_centre @ _shift((-centre[0], -centre[1]))
    if not homography[2, 2] > 0:
        raise InputError(f"near camera: tilt = {tilt}: the horizon lies within the far image; use a smaller tilt")
    return CameraMapping(homography / homography[2, 2])


def beside_the_hole(center: Pair, radius: float, ratio: float, near: Frame) -> Pair:
    """Centre of a near field with the hole's right edge a quarter of its width from its left side, pixels.

    Raises InputError for a ratio of 1 or less.
    """
    _require_ratio(ratio)
    return center[0] + radius + near.width / (4 * ratio), center[1]


def near_far_scene(field: DisplacementField, hole: Hole, texture: TwoScaleTexture, mapping: CameraMapping,
                   motion: SetUpMotion, far_frame: Frame, near_frame: Frame) -> NearFarScene:
    """Show a specimen to both cameras: the far one sees the coarse speckles alone, at full contrast.

    field, hole, texture: specimen's frame; mapping, motion: of the near camera. The hole's edge is given for the far
    picture; in the near one it is sharper, as the fine speckles are smaller than the coarse ones.
    Raises InputError where the near camera looks beyond the far picture.
    """
    sharper = dataclasses.replace(hole, edge=hole.edge * texture.fine.size_factor / texture.coarse.size_factor)
    near = NearScene(Scene(texture, field, sharper), mapping, motion)
    return NearFarScene(Scene(texture.coarse, field, hole), near, far_frame, near_frame)


def write_near_far(folder: Path, scene: NearFarScene) -> tuple[Path, ...]:
    """Write the four images, uncompressed TIFF, to a folder; returns their paths, far before near.

    f_f(X) = g_f(X + u(X)) and f_n(phi(X)) = g_n(phi(T(X + u(X)))) hold without any interpolation.
    Raises InputError for a field that folds the plane or a file that cannot be written.
    """
    far = folder / FAR_FILES[0], folder / FAR_FILES[1]
    near = folder / NEAR_FILES[0], folder / NEAR_FILES[1]
    frame = scene.far_frame
    write_images(*far, scene.far, frame.digitiser, frame.width, frame.height)
    frame = scene.near_frame
    write_images(*near, scene.near, frame.digitiser, frame.width, frame.height, _NEAR_STREAM)
    return far + near


def _require_ratio(ratio: float) -> None:
    if not 1 < ratio < math.inf:
        raise InputError(f"near camera: ratio = {ratio}: must be above 1 near pixel per far pixel")


def _shift(vector: Pair) -> NDArray[np.float64]:
    return np.array([[1.0, 0.0, vector[0]], [0.0, 1.0, vector[1]], [0.0, 0.0, 1.0]])

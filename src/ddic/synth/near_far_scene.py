"""A near-field and a far-field pair of one specimen, whose displacement and set-up are known exactly."""

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.images.camera import CameraMapping
from ddic.images.window import Window
from ddic.io.replace_on_exit import NewFiles, begin_files
from ddic.mesh.rotation import build_rotation
from ddic.synth.fields import DisplacementField, Hole, Pair, Vector, require_finite
from ddic.synth.render import Picture, Scene, write_pair
from ddic.synth.speckle import TwoScaleTexture

FAR_FILES = ("far_reference.tif", "far_deformed.tif")
NEAR_FILES = ("near_reference.tif", "near_deformed.tif")

# The near pair's noise is drawn from other streams than the far pair's 0 and 1.
_NEAR_STREAM = 2


@dataclass(frozen=True)
class SetUpMotion:
    """Rigid motion T(Y) = centre + R(rotation) (Y - centre) + alpha of the near set-up between its two pictures.

    Raises InputError where a number is not finite.

    Attributes
    ----------
    alpha : (float, float)
        Pixels of the specimen's frame.
    rotation_degrees : float
        From x towards y.
    centre : (float, float)
        X0, pixels of the specimen's frame.
    """

    alpha: Pair = (0.0, 0.0)
    rotation_degrees: float = 0.0
    centre: Pair = (0.0, 0.0)

    def __post_init__(self) -> None:
        require_finite("near set-up", alpha=self.alpha, rotation_degrees=self.rotation_degrees, centre=self.centre)

    def move(self, points: Array) -> Array:
        """Evaluate T at points Y, (n, 2), pixels of the specimen's frame."""
        turned = (points - self.centre) @ self._rotation().T
        return np.asarray(turned + self.centre + self.alpha)

    def move_back(self, points: Array) -> Array:
        """Evaluate the inverse of T at points T(Y), (n, 2), pixels of the specimen's frame."""
        turned = points - self.centre - np.array(self.alpha)
        return np.asarray(turned @ self._rotation() + self.centre)

    def _rotation(self) -> Array:
        """R, (2, 2)."""
        return build_rotation(math.radians(self.rotation_degrees))


@dataclass(frozen=True, eq=False)
class NearCamera:
    """The near camera: where it looks, how its set-up moves, and what its pictures are like.

    Attributes
    ----------
    mapping : CameraMapping
        phi, from the specimen's frame to the camera's pixels.
    motion : SetUpMotion
        T, of the set-up between the two pictures.
    picture : Picture
        Size, bit depth and noise.
    """

    mapping: CameraMapping
    motion: SetUpMotion
    picture: Picture


@dataclass(frozen=True, eq=False)
class NearScene:
    """What the near camera looks at, in its own pixels.

    Attributes
    ----------
    surface : Scene
        Texture, displacement u and hole in the specimen's frame.
    camera : NearCamera
        phi and T.
    """

    surface: Scene
    camera: NearCamera

    def reference_grey(self, points: Array) -> Array:
        """Evaluate the grey level f_n before the motion, (n,) fractions of full scale, at near pixels (n, 2)."""
        return self.surface.reference_grey(self.camera.mapping.to_specimen(points))

    def deformed_grey(self, points: Array) -> Array:
        """Evaluate the grey level g_n after the motion at near pixels: f_n(phi(X)) = g_n(phi(T(X + u(X))))."""
        moved = self.camera.mapping.to_specimen(points)
        return self.surface.deformed_grey(self.camera.motion.move_back(moved))

    def displacement(self, points: Array) -> Array:
        """Evaluate phi(T(X + u(X))) - phi(X), near pixels, at points phi(X), (n, 2), of the near reference image."""
        specimen = self.camera.mapping.to_specimen(points)
        moved = self.camera.motion.move(specimen + self.surface.field.displacement(specimen))
        return np.asarray(self.camera.mapping.to_image(moved) - points)


@dataclass(frozen=True, eq=False)
class NearFarScene:
    """One specimen and the two cameras that look at it; the far camera's pixels are the specimen's frame.

    Raises InputError where the near camera looks beyond the far picture.

    Attributes
    ----------
    far : Scene
        What the far camera sees.
    far_picture : Picture
        Size, bit depth and noise of its pictures.
    near : NearScene
        What the near camera sees.
    """

    far: Scene
    far_picture: Picture
    near: NearScene

    def __post_init__(self) -> None:
        camera = self.near.camera
        try:
            near_image = Window.of_size(camera.picture.width, camera.picture.height)
            corners = camera.mapping.to_specimen(near_image.corners)
        except ValueError as error:
            raise InputError(f"near camera: {error}; use a smaller tilt") from error
        limits = np.array([self.far_picture.width - 1, self.far_picture.height - 1])
        if not ((corners >= 0) & (corners <= limits)).all():
            (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
            raise InputError(
                f"near field: x {x0:.6g}..{x1:.6g}, y {y0:.6g}..{y1:.6g} px lies partly outside the far image, "
                f"x 0..{limits[0]}, y 0..{limits[1]} px; move its centre, use a larger ratio or a smaller near image")


def build_near_mapping(ratio: float, centre: Pair, picture: Picture, angle_degrees: float = 0.0,
                       tilt: Pair = (0.0, 0.0)) -> CameraMapping:
    """Build the near camera's phi: ``centre`` in the middle of its picture, magnified ``ratio`` times there.

    It leads from the specimen's frame to near pixels. ``centre`` is X0, pixels of the specimen's frame; ``ratio`` is
    near pixels per far pixel, above 1; ``angle_degrees`` is that of the picture, from x towards y. ``tilt`` is how much
    farther, as a fraction, the specimen is at the middle of the right and of the lower edge of an upright near field
    than at its centre. Raises InputError for a ratio of 1 or less, a number that is not finite, or a horizon within the
    far image.
    """
    require_finite("near camera", centre=centre, angle_degrees=angle_degrees, tilt=tilt)
    _require_ratio(ratio)
    angle = math.radians(angle_degrees)
    c, s = ratio * math.cos(angle), ratio * math.sin(angle)
    slope = np.array(tilt) * 2 * ratio / np.array([picture.width, picture.height])
    about_centre = np.array([[c, -s, 0.0], [s, c, 0.0], [slope[0], slope[1], 1.0]])
    homography = _translation(picture.middle) @ about_centre @ _translation((-centre[0], -centre[1]))
    if not homography[2, 2] > 0:
        raise InputError(f"near camera: tilt = {tilt}: the horizon lies within the far image; use a smaller tilt")
    return CameraMapping(homography / homography[2, 2])


def place_beside_hole(center: Pair, radius: float, ratio: float, near: Picture) -> Pair:
    """Place a near field so that the hole's right edge is a quarter of its width from its left side.

    Hole and centre of the near field are in far pixels, ``ratio`` is near pixels per far pixel. Raises InputError for a
    ratio of 1 or less.
    """
    _require_ratio(ratio)
    return center[0] + radius + near.width / (4 * ratio), center[1]


def build_near_far_scene(texture: TwoScaleTexture, field: DisplacementField, hole: Hole, far_picture: Picture,
                         near: NearCamera) -> NearFarScene:
    """Show a specimen to both cameras: the far one sees the coarse speckles alone, at full contrast.

    Texture, displacement and hole are in the specimen's frame, which is the far camera's pixels. The hole's edge is
    given for the far picture; in the near one it is sharper, as the fine speckles are smaller than the coarse ones.
    Raises InputError where the near camera looks beyond the far picture.
    """
    near_edge = hole.edge * texture.fine.size_factor / texture.coarse.size_factor
    near_hole = dataclasses.replace(hole, edge=near_edge)
    return NearFarScene(
        far=Scene(texture.coarse, field, hole),
        far_picture=far_picture,
        near=NearScene(Scene(texture, field, near_hole), near),
    )


def write_near_far(folder: Path, scene: NearFarScene, files: NewFiles | None = None) -> tuple[Path, ...]:
    """Write the four images, uncompressed TIFF, to a folder: far before near, reference before deformed.

    f_f(X) = g_f(X + u(X)) and f_n(phi(X)) = g_n(phi(T(X + u(X)))) hold without any interpolation. The folder must
    exist. The images take their names with ``files``; by default they do so by themselves. Raises InputError for a
    field that folds the plane or a folder that cannot be written to, OSError where the disk does not take them.
    """
    far = folder / FAR_FILES[0], folder / FAR_FILES[1]
    near = folder / NEAR_FILES[0], folder / NEAR_FILES[1]
    with begin_files(files) as new:
        write_pair(far, scene.far, scene.far_picture, files=new)
        write_pair(near, scene.near, scene.near.camera.picture, _NEAR_STREAM, new)
    return far + near


def _require_ratio(ratio: float) -> None:
    """Refuse a ratio of 1 or less."""
    if not 1 < ratio < math.inf:
        raise InputError(f"near camera: ratio = {ratio}: must be above 1 near pixel per far pixel")


def _translation(vector: Vector) -> Array:
    """Homography that moves by a vector, (3, 3)."""
    return np.array([[1.0, 0.0, vector[0]], [0.0, 1.0, vector[1]], [0.0, 0.0, 1.0]])

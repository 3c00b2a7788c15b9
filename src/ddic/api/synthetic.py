"""Image pairs with a known displacement, to try a measurement out before the test."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.errors import InputError, describe_nearest
from ddic.synth.fields import DisplacementField, Hole
from ddic.synth.render import Digitiser, Picture, Scene, render_pair
from ddic.synth.speckle import SpeckleTexture

Image = NDArray[np.uint8]

DIFFERENCE_PX = 1e-3
"""Half of the distance, pixels, over which the gradient of a given displacement is taken. It only leads the search for
the point that moved to a pixel; a larger one slows that search where the gradient varies."""


@dataclass(frozen=True)
class _GivenField:
    """A displacement given as a function, with its gradient by central differences."""

    displacement: Callable[[Array], Array]

    def gradient(self, points: Array) -> Array:
        """Gradient du_i/dx_j (n, d, d) at points (n, d)."""
        changes = [self.displacement(points + shift) - self.displacement(points - shift)
                   for shift in DIFFERENCE_PX * np.eye(points.shape[1])]
        return np.asarray(np.stack(changes, axis=2) / (2 * DIFFERENCE_PX))


def make_synthetic_pair(displacement: Callable[[Array], Any] | DisplacementField, size: tuple[int, ...], *,
                        noise: float = 0.0, seed: int = 0,
                        hole: Mapping[str, Any] | None = None) -> tuple[Image, Image]:
    """Picture a speckled plane, or a volume, before and after a displacement, without interpolating an image.

    The texture is known at any point, so that f(x) = g(x + u(x)) holds but for noise and rounding to 8 bit.

    Parameters
    ----------
    displacement : callable or DisplacementField
        From points (n, 2) to their displacement (n, 2), pixels of the reference image; smooth, and defined a few pixels
        beyond the image too. Of volumes (n, 3).
    size : (width, height) or (width, height, depth)
        Pixels.
    noise : float, optional
        Standard deviation of the camera's noise in both images, grey levels.
    seed : int, optional
        Of the speckles and of the noise.
    hole : mapping, optional
        Round hole in the reference image, dark: ``center`` and ``radius``, pixels, as a circle of a case file. Volumes
        have none.

    Returns
    -------
    reference, deformed : (height, width) or (depth, height, width) arrays of uint8
        Grey levels.

    Raises
    ------
    InputError
        Where the displacement folds the plane, or a number is out of its range.
    ConvergenceError
        Where the displacement is not smooth enough to be inverted.
    """
    _refuse_impossible(displacement, size, hole)
    field: Any = displacement if hasattr(displacement, "gradient") else _GivenField(_as_arrays(displacement))
    width, height, *depth = size
    picture = Picture(width, height, Digitiser(noise=noise, seed=seed), *depth)
    scene = Scene(SpeckleTexture(seed), field, None if hole is None else _make_hole(hole))
    pair = render_pair(scene, picture)
    return pair.reference, pair.deformed


def _refuse_impossible(displacement: Any, size: Any, hole: object) -> None:
    numbers = np.asarray(size)
    if numbers.shape not in ((2,), (3,)) or numbers.dtype.kind not in "iu":
        raise InputError(f"size = {size}: expected (width, height) or (width, height, depth), whole numbers of pixels")
    if not (callable(displacement) or hasattr(displacement, "gradient")):
        raise InputError(f"displacement: {type(displacement).__name__} given, a function of points (n, {len(size)}) "
                         "expected")
    if len(size) == 3 and hole is not None:
        raise InputError(f"hole: a volume, size = {size}, has none; give a plane image, (width, height)")
    if hasattr(displacement, "gradient"):
        try:
            displacement.displacement(np.zeros((1, len(size))))
        except ValueError as error:
            raise InputError(f"displacement: {type(displacement).__name__} has other axes than size = {size}; give a "
                             f"field of {len(size)} components") from error


def _make_hole(circle: Any) -> Hole:
    """The hole of a circle as a case file has it."""
    keys = ["center", "radius"]
    if not isinstance(circle, Mapping) or not set(keys) <= set(circle):
        raise InputError(f'hole = {circle}: expected a circle, {{"center": (x, y), "radius": r}}, pixels')
    for key in circle:
        if key not in keys:
            raise InputError(f"hole.{key}: unknown key; {describe_nearest(key, keys)}")
    return Hole(circle["center"], circle["radius"])


def _as_arrays(displacement: Callable[[Array], Any]) -> Callable[[Array], Array]:
    """Give arrays of their own, of floats and as many as there are points: the renderer adds to what it gets."""

    def evaluate(points: Array) -> Array:
        found = np.array(displacement(points), dtype=np.float64)
        if found.shape != points.shape:
            raise InputError(f"displacement: the function returned an array of shape {found.shape} for points of shape "
                             f"{points.shape}; return one of the same shape")
        return found

    return evaluate

"""Parts of a volume found again in the deformed one, turned by up to some 25 degrees: what features are in images.

A ball of blocks is sought in the whole deformed volume, turned by each of some rotations. Where it is found, what lies
beside it is matched from its affine map, and so on from the best match that has neighbours left.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from heapq import heappop, heappush
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray
from ddic.images.binned import ArraySource
from ddic.images.grey_levels import measure_feature_size
from ddic.mesh.mesh import Mesh
from ddic.start.binned_pair import BinnedPair

LARGEST_ANGLE = 26.0
"""Largest rotation by which a ball is turned before it is sought, degrees. A larger one takes longer, as its cube."""

BETWEEN_ROTATIONS = 10.0
"""Side of the cubes of rotation vectors, degrees, of which corners and middles are tried: no rotation is farther than 6
degrees from one of them. A larger value finds less."""

LARGEST_SEARCHED = 300_000
"""Most blocks of the volume in which a ball is sought: all rotations then take a second or so. A larger value finds
smaller balls, later."""

SMOOTHED = 0.8
"""Standard deviation, blocks, by which volumes are smoothed: speckles smaller than a block look different half a block
farther on."""

RADIUS = 3.5
"""Radius of a ball, features: it holds some 200 of them. With more, strain of 15 % leaves less in common; with fewer,
balls are alike by chance."""

MOST_SAMPLES = 2000
"""Blocks of a ball by which it is matched. More take longer."""

FEWEST_SAMPLES = 200
"""Of these that must be seen in both volumes."""

N_PLACES = 1000
"""About how many places are matched, evenly over the region. More take longer."""

FOUND = 0.7
"""Correlation coefficient from which on a ball is found, after its affine motion. Those that have nothing in common
have 0.5 at the best of all places."""

MOST_STEPS, SMALL_STEP = 15, 0.05
"""Of Gauss-Newton on a ball, and motion of it, blocks, below which there is none."""

RIDGE = 1e-6
"""Of the mean diagonal entry, added to each: a larger one slows Gauss-Newton down."""

MOST_SOUGHT = 6
"""Balls that are sought in turn, each where those before led least: what parts is found from a few of them."""

LEFT = 0.1
"""Share of the places that need not be matched: at the edge of what leaves the image."""

Image = NDArray[np.float32]

Motion = Array
"""Where a ball goes, (3, 4): the gradient of its affine map, and the place of its middle, blocks."""


class Ball(NamedTuple):
    """A ball that was found.

    Attributes
    ----------
    coefficient : float
        Of correlation.
    motion : (3, 4) array
        How it has moved, as Motion says.
    """

    coefficient: float
    motion: Motion


def match_blocks(pair: BinnedPair, mesh: Mesh) -> tuple[Array, Array]:
    """Match places all over a mesh, itself in pixels: places, and how they are displaced, (n, 3) each, blocks."""
    volumes, ratio = _smooth(pair, mesh), 1
    while pair.size.prod() / ratio**3 > LARGEST_SEARCHED:
        ratio *= 2
    wide = volumes if ratio == 1 else _smooth(pair.bin_at_sizes([ratio * pair.factor])[ratio * pair.factor], mesh)
    found: dict[tuple[int, ...], Ball] = {}
    if volumes is None or wide is None:
        return np.zeros((0, 3)), np.zeros((0, 3))
    places, is_place = _spread_places(volumes.active)
    is_left = is_place.copy()
    for _ in range(MOST_SOUGHT):
        if is_left.sum() <= LEFT * is_place.sum():
            break
        depth = scipy.ndimage.distance_transform_edt(np.pad(is_left, 1))[1:-1, 1:-1, 1:-1]
        first = tuple(map(int, np.unravel_index(depth.argmax(), depth.shape)))
        seed = _seek_at(places[first], wide, ratio, volumes)
        # What was sought in vain is not sought again.
        is_left[first] = False
        if seed is not None:
            found[first] = seed
            _spread(volumes, places, is_place, first, found)
            is_left[tuple(np.transpose(list(found)))] = False
    starts = np.array([places[number] for number in found]).reshape(-1, 3)
    return starts, np.array([ball.motion[:, 3] for ball in found.values()]).reshape(-1, 3) - starts


def _spread_places(active: BoolArray) -> tuple[Array, BoolArray]:
    """Places on a grid of cubes over the active blocks, (..., 3), and which of them are active themselves, (...)."""
    spacing = max((active.sum() / N_PLACES) ** (1 / 3), 1.0)
    of_blocks = [np.flatnonzero(active.any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
    lines = [np.unique(np.rint(np.arange(some[0] + (spacing - 1) / 2, some[-1] + 0.5, spacing))) for some in of_blocks]
    places = np.stack(np.meshgrid(*lines, indexing="ij")[::-1], axis=-1)
    return places, _look_up(active, places)


def _seek_at(place: Array, wide: _Volumes, ratio: int, volumes: _Volumes) -> Ball | None:
    """Seek the ball about a place in blocks of which ``ratio`` smaller ones make a side, and match it in these."""
    offset = (ratio - 1) / 2
    middle = np.rint((place - offset) / ratio)
    found = wide.seek(middle)
    if found is None or ratio == 1:
        return found
    gradient = found.motion[:, :3]
    moved = found.motion[:, 3] * ratio + offset + gradient @ (place - middle * ratio - offset)
    return volumes.match(place, np.column_stack([gradient, moved]))


def _spread(volumes: _Volumes, places: Array, is_place: BoolArray, first: tuple[int, ...],
            found: dict[tuple[int, ...], Ball]) -> None:
    """Match what lies beside the first place, and beside that, the best first; it is added to what is found."""
    waiting = [(-found[first].coefficient, first)]
    while waiting:
        _, number = heappop(waiting)
        motion = found[number].motion
        for axis, step in product(range(3), (-1, 1)):
            beside = (*number[:axis], number[axis] + step, *number[axis + 1:])
            if beside in found or not 0 <= beside[axis] < is_place.shape[axis] or not is_place[beside]:
                continue
            moved = motion[:, 3] + motion[:, :3] @ (places[beside] - places[number])
            ball = volumes.match(places[beside], np.column_stack([motion[:, :3], moved]))
            if ball is not None:
                found[beside] = ball
                heappush(waiting, (-ball.coefficient, beside))


def _smooth(pair: BinnedPair, mesh: Mesh) -> _Volumes | None:
    """Both volumes, smoothed; None where the region shows no features, or none that are small beside it."""
    active = pair.find_active(pair.scale(mesh)) > 0
    usable = pair.deformed.find_usable(pair.deformed.extent)
    f, g = (scipy.ndimage.gaussian_filter(source.read_whole().astype(np.float32), SMOOTHED)
            for source in (pair.reference, pair.deformed))
    blocks = np.argwhere(active)[:, ::-1]
    some = blocks[np.linspace(0, len(blocks) - 1, min(len(blocks), 9)).astype(int)]
    size = measure_feature_size(ArraySource(pair.reference.image.path, f), some)
    if not np.isfinite(size):
        return None
    return _Volumes(f, g, active, np.ones(g.shape, bool) if usable is None else usable > 0, RADIUS * size)


@dataclass(frozen=True, eq=False)
class _Volumes:
    """Both volumes in blocks, smoothed: f and g, which blocks of them count, and the radius of balls in them."""

    f: Image
    g: Image
    active: BoolArray
    usable: BoolArray
    radius: float

    @cached_property
    def offsets(self) -> Array:
        """Blocks of a ball from its middle, (n, 3)."""
        reach = np.arange(-int(self.radius), int(self.radius) + 1.0)
        offsets = np.stack(np.meshgrid(reach, reach, reach, indexing="ij")[::-1], axis=-1).reshape(-1, 3)
        return np.asarray(offsets[(offsets**2).sum(axis=1) <= self.radius**2])

    @cached_property
    def slopes(self) -> list[Image]:
        """Slopes of f along x, y and z, grey levels a block."""
        return list(np.gradient(self.f)[::-1])

    def match(self, place: Array, motion: Motion) -> Ball | None:
        """Match the ball about a place, from a motion near the right one, by Gauss-Newton of its affine map."""
        offsets = self.offsets[_look_up(self.active, place + self.offsets)]
        offsets = offsets[::-(-len(offsets) // MOST_SAMPLES) or 1]
        blocks = tuple((place + offsets).astype(int).T[::-1])
        f, slopes = self.f[blocks], np.stack([slope[blocks] for slope in self.slopes], axis=1)
        by_motion = np.concatenate([(slopes[:, :, None] * offsets[:, None]).reshape(-1, 9), slopes], axis=1)
        coefficient = 0.0
        for _ in range(MOST_STEPS):
            moved = offsets @ motion[:, :3].T + motion[:, 3]
            seen = _look_up(self.usable, moved)
            if seen.sum() < FEWEST_SAMPLES:
                return None
            of_f, of_g = (values - values.mean() for values in (f[seen], _sample(self.g, moved[seen])))
            spreads = np.linalg.norm(of_f), np.linalg.norm(of_g)
            if not min(spreads) > 0.0:
                return None
            coefficient = float(of_f @ of_g / np.prod(spreads))
            design = by_motion[seen] - by_motion[seen].mean(axis=0)
            normal = design.T @ design
            # A volume that is the same along an axis tells no motion along it.
            normal += RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))
            # What motion of f, before all that is known, makes it like g.
            step = np.linalg.solve(normal, design.T @ (of_g * (spreads[0] / spreads[1]) - of_f))
            inverse = np.linalg.inv(np.eye(3) + step[:9].reshape(3, 3))
            gradient = motion[:, :3] @ inverse
            motion = np.column_stack([gradient, motion[:, 3] - gradient @ step[9:]])
            if np.linalg.norm(step[9:]) + self.radius * np.linalg.norm(step[:9]) < SMALL_STEP:
                break
        return Ball(coefficient, motion) if coefficient >= FOUND else None

    def seek(self, place: Array) -> Ball | None:
        """Match the ball about a place from where it is most like one of the deformed volume, in any rotation."""
        best, motion = 0.0, np.zeros((3, 4))
        for rotation in list_rotations():
            # What is at an offset after the rotation was there before it.
            before = place + self.offsets @ rotation
            counted = _look_up(self.active, before)
            if counted.sum() < FEWEST_SAMPLES:
                continue
            values = _sample(self.f, before)
            values = np.where(counted, values - values[counted].mean(), 0.0)
            spectrum = self._spectrum_of_g * np.conj(scipy.fft.rfftn(self._paint(values), self._shape))
            coefficients = self._invert(spectrum) / (self._spread * np.linalg.norm(values))
            at = np.unravel_index(coefficients.argmax(), coefficients.shape)
            if coefficients[at] > best:
                best, motion = float(coefficients[at]), np.column_stack([rotation, np.array(at[::-1], dtype=float)])
        return self.match(place, motion) if best > 0.0 else None

    @cached_property
    def _shape(self) -> tuple[int, ...]:
        # A ball has room in the thinnest volume.
        return tuple(scipy.fft.next_fast_len(max(n, 2 * int(self.radius) + 1), real=True) for n in self.g.shape)

    @cached_property
    def _spectrum_of_g(self) -> NDArray[np.complex64]:
        return np.asarray(scipy.fft.rfftn(self.g - self.g.mean(), self._shape))

    @cached_property
    def _spread(self) -> Image:
        """Root of the sum of squares about the mean of g in the ball about each block; no smaller where g is flat."""
        g = self.g - self.g.mean()
        of_ball = np.conj(scipy.fft.rfftn(self._paint(np.ones(len(self.offsets))), self._shape))
        sums, squares = (self._invert(scipy.fft.rfftn(values, self._shape) * of_ball) for values in (g, g**2))
        variance = squares - sums**2 / len(self.offsets)
        return np.asarray(np.sqrt(np.maximum(variance, max(FLAT * float(variance.max()), TINY))))

    def _paint(self, values: Array) -> Image:
        """A ball about the first block of a periodic volume."""
        painted = np.zeros(self._shape, np.float32)
        painted[tuple(self.offsets.astype(int).T[::-1])] = values
        return painted

    def _invert(self, spectrum: NDArray[np.complex64]) -> Image:
        """What a spectrum is of, where a ball's middle is in the volume."""
        return np.asarray(scipy.fft.irfftn(spectrum, self._shape)[tuple(map(slice, self.g.shape))])


FLAT = 1e-3
"""Variance in a ball, of the largest in any, up to which the deformed volume is flat there."""

TINY = 1e-30
"""A sum of squares below any that is not 0."""


def _sample(values: Image, places: Array) -> Array:
    """Grey levels at places, (n, 3), between blocks."""
    return np.asarray(scipy.ndimage.map_coordinates(values, places.T[::-1], order=1, mode="nearest"))


def _look_up(mask: BoolArray, places: Array) -> BoolArray:
    """What a mask says of the blocks nearest to places, (..., 3); False beyond it."""
    blocks = np.moveaxis(np.rint(places).astype(int), -1, 0)[::-1]
    inside = np.all([(at >= 0) & (at < n) for at, n in zip(blocks, mask.shape, strict=True)], axis=0)
    return np.asarray(inside & mask[tuple(np.where(inside, at, 0) for at in blocks)])


@cache
def list_rotations() -> Array:
    """Rotations about any axis, at most by LARGEST_ANGLE, evenly spread, (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    n = int(LARGEST_ANGLE / BETWEEN_ROTATIONS) + 1
    corners = np.array(list(product(range(-n, n + 1), repeat=3)), dtype=float)
    vectors = BETWEEN_ROTATIONS * np.concatenate([corners, corners + 0.5])
    vectors = vectors[np.linalg.norm(vectors, axis=1) <= LARGEST_ANGLE]
    return np.asarray(Rotation.from_rotvec(vectors, degrees=True).as_matrix())

"""Small pairs of which a part is spoilt: hidden, dirty, bright, blurred, without texture or out of the image."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from ddic.mesh.mesh import Mesh
from ddic.parallel.team import Team
from ddic.results.measurement import Measurement
from ddic.synth.fields import Affine
from ddic.synth.speckle import SpeckleTexture
from support.cases import Ears, write_case
from support.measuring import measure
from support.pictures import pair_of, square_mesh

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Box = tuple[int, int, int, int]
"""First column and row, and those past the last, pixels."""

SIDE = 256
FIELD = Affine(((0.004, 0.003), (-0.002, -0.003)), (2.3, -1.6), (SIDE / 2, SIDE / 2))
MESH = square_mesh(32.0, 224.0)
"""12 x 12 cells of 16 px."""

NOISE = 2.0
"""Standard deviation of either image, grey levels."""

WITHIN = 0.05
"""Pixels. Noise of 2 grey levels leaves 0.02 px RMS on these cells and 0.07 px at a corner of the mesh;
what is spoilt moves nodes by half a pixel and more."""


@dataclass(frozen=True, eq=False)
class Spoilt:
    """A pair, and what of the deformed image does not show the specimen.

    reference, deformed : (SIDE, SIDE) uint8 array
    hidden : (SIDE, SIDE) bool array, of the deformed image
    """

    reference: Image
    deformed: Image
    hidden: NDArray[np.bool_]

    @property
    def pair(self) -> tuple[Image, Image]:
        return self.reference, self.deformed

    def count_hidden(self, mesh: Mesh = MESH) -> NDArray[np.float64]:
        """Share of each cell's pixels that the deformed image hides: sampled at every pixel of a square cell."""
        y, x = np.mgrid[0:SIDE, 0:SIDE].astype(float)
        points = np.column_stack([x.ravel(), y.ravel()])
        column, row = np.clip(np.rint(points + FIELD.displacement(points)).astype(int), 0, SIDE - 1).T
        hidden = self.hidden[row, column].reshape(SIDE, SIDE)
        corners = mesh.nodes[mesh.connectivity.reshape(-1, 4)]
        low, high = corners.min(axis=1).astype(int), corners.max(axis=1).astype(int)
        return np.array([hidden[a[1]:b[1], a[0]:b[0]].mean() for a, b in zip(low, high, strict=True)])


def digitise(levels: Array) -> Image:
    return np.asarray(np.clip(np.rint(levels), 0, 255), dtype=np.uint8)


@cache
def clean() -> Spoilt:
    """Nothing of it is spoilt."""
    pair = pair_of(FIELD, SIDE, 32)
    random = np.random.default_rng(1)
    f, g = (digitise(image + NOISE * random.standard_normal(image.shape)) for image in (pair.reference, pair.deformed))
    return Spoilt(f, g, np.zeros(f.shape, dtype=bool))


def hide(box: Box, kind: str = "black") -> Spoilt:
    """A rectangle of the deformed image is black, grey or shows another specimen."""
    x0, y0, x1, y1 = box
    y, x = np.mgrid[y0:y1, x0:x1].astype(float)
    covers: Mapping[str, Callable[[], Array]] = {
        "black": lambda: np.zeros(x.shape), "grey": lambda: np.full(x.shape, 127.0),
        "speckle": lambda: np.asarray(255.0 * SpeckleTexture(77).grey(x, y))}
    noise = NOISE * np.random.default_rng(5).standard_normal(x.shape)
    deformed, hidden = clean().deformed.copy(), clean().hidden.copy()
    deformed[y0:y1, x0:x1] = digitise(covers[kind]() + noise)
    hidden[y0:y1, x0:x1] = True
    return replace(clean(), deformed=deformed, hidden=hidden)


def soil(n_spots: int = 8, radius: int = 4) -> Spoilt:
    """Dark spots of the deformed image."""
    random = np.random.default_rng(11)
    dirt = np.zeros((SIDE, SIDE), dtype=np.uint8)
    for x, y in random.integers(50, SIDE - 50, (n_spots, 2)).tolist():
        cv2.circle(dirt, (x, y), radius, 1, -1)
    hidden = dirt.astype(bool)
    return replace(clean(), deformed=np.where(hidden, 10, clean().deformed).astype(np.uint8), hidden=hidden)


def change(how: Callable[[Array], Array]) -> Spoilt:
    """The deformed image with other grey levels."""
    return replace(clean(), deformed=digitise(how(clean().deformed.astype(float))))


def blank_half() -> Spoilt:
    """The right half of both images bears no speckle; what of it moves to the left is hidden."""
    random = np.random.default_rng(9)
    x = np.arange(SIDE)
    edge = SIDE / 2
    images = []
    for image, shift in ((clean().reference, 0.0), (clean().deformed, FIELD.displacement(np.full((1, 2), edge))[0, 0])):
        plain = digitise(120.0 + NOISE * random.standard_normal((SIDE, SIDE)))
        images.append(np.where(x > edge + shift, plain, image).astype(np.uint8))
    hidden = np.broadcast_to(x > edge, (SIDE, SIDE))
    return Spoilt(images[0], images[1], hidden)


def blur(along: float) -> Spoilt:
    """The deformed image is blurred along x; its noise is that of the camera."""
    pair = pair_of(FIELD, SIDE, 32)
    blurred = cv2.GaussianBlur(pair.deformed.astype(float), (0, 0), sigmaX=along, sigmaY=0.01)
    noise = NOISE * np.random.default_rng(2).standard_normal(blurred.shape)
    return replace(clean(), deformed=digitise(blurred + noise))



def measure_files(folder: Path, scene: Spoilt, more: str = "") -> tuple[Measurement, Ears]:
    """Measure a pair from files on one rank, and what a listener is told; more: further sections of the case."""
    tifffile.imwrite(folder / "f.tif", scene.reference)
    tifffile.imwrite(folder / "g.tif", scene.deformed)
    ears = Ears()
    path = write_case(folder, more, region="region = [32, 32, 224, 224]")
    return measure(Team.alone(), path, ears), ears

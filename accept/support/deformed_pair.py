"""Exact pairs of large deformations, frames of a motion that grows, what is measured, and the noise floor."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

import ddic
from bench.support.opened_pair import picture
from bench.support.runs import source_version
from ddic.functionals.correlation import read_correlation
from ddic.images.binned import ArraySource
from ddic.images.sub_image import MaskedSource
from ddic.kinematics.strain import compute_strain
from ddic.mesh.rotation import build_rotation
from ddic.synth.render import find_reference_points
from ddic.synth.speckle import SpeckleTexture

Array = NDArray[np.float64]
Pair = tuple[NDArray[Any], NDArray[Any]]

STEP = 1e-3
"""Half of the distance, pixels, over which gradients are taken; they only lead the search for where a pixel was."""


@dataclass(frozen=True, eq=False)
class Deformation:
    """A displacement known everywhere.

    Attributes
    ----------
    displacement : callable
        From points (n, 2) to their displacement (n, 2), pixels.
    """

    displacement: Callable[[Array], Array]

    def gradient(self, points: Array) -> Array:
        """Displacement gradient du_i/dx_j at points (n, 2), (n, 2, 2)."""
        columns = []
        for axis in range(2):
            step = np.zeros(2)
            step[axis] = STEP
            change = self.displacement(points + step) - self.displacement(points - step)
            columns.append(change / (2 * STEP))
        return np.stack(columns, axis=2)


@dataclass(frozen=True)
class Camera:
    """What the pictures are like.

    Attributes
    ----------
    size : (width, height)
        Pixels.
    noise : float
        Standard deviation, grey levels of 256.
    bits : int
        8 or 16.
    speckle : float
        Size of the speckles, times the reference size.
    seed : int
        Of the speckles and of the noise.
    """

    size: tuple[int, int]
    noise: float = 2.0
    bits: int = 8
    speckle: float = 1.0
    seed: int = 3


def make_linear(gradient: Array, centre: Array, translation: Array | None = None) -> Deformation:
    """Make a homogeneous deformation.

    Parameters
    ----------
    gradient : (2, 2) array
        du_i/dx_j.
    centre : (2,) array
        Pixels.
    translation : (2,) array, optional
        Of the centre, pixels; none by default.

    Returns
    -------
    Deformation
        Displacement gradient (x - centre) + translation.
    """
    moved = np.zeros(2) if translation is None else translation
    return Deformation(lambda points: np.asarray((points - centre) @ gradient.T + moved))


def make_rotation(degrees: float, scale: float = 1.0) -> Array:
    """Make the displacement gradient of a rotation with a scale.

    Parameters
    ----------
    degrees : float
        From x towards y.
    scale : float
        Times which lengths grow.

    Returns
    -------
    (2, 2) array
        scale R - I.
    """
    return np.asarray(scale * build_rotation(np.deg2rad(degrees)) - np.eye(2))


def render_deformed(deformation: Deformation, camera: Camera) -> Pair:
    """Draw both images, without interpolation."""
    width, height = camera.size
    texture, random = SpeckleTexture(camera.seed, size_factor=camera.speckle), np.random.default_rng(camera.seed)
    y, x = np.mgrid[0:height, 0:width].astype(float)
    points = np.column_stack([x.ravel(), y.ravel()])
    drawn = []
    for origins in (points, find_reference_points(deformation, points)):
        noise = camera.noise * random.standard_normal(len(points))
        drawn.append(picture(texture, origins, camera.bits, noise).reshape(height, width))
    return drawn[0], drawn[1]


@dataclass(frozen=True)
class Measured:
    """What a measurement came to.

    Attributes
    ----------
    rms, largest : float
        Error at the nodes, pixels; nan where it did not converge.
    refusal : str
        Why it was refused; empty where it converged.
    n_iterations : int
        Of Gauss-Newton.
    largest_strain : float
        Green-Lagrange, of any cell; nan where it did not converge.
    """

    rms: float
    largest: float
    refusal: str = ""
    n_iterations: int = 0
    largest_strain: float = np.nan

    @property
    def converged(self) -> bool:
        """Whether it did."""
        return not self.refusal


def measure_deformed(pair: Pair, mesh: ddic.Mesh, deformation: Deformation,
                     options: dict[str, Any] | None = None, start: Any = None) -> Measured:
    """Measure a pair, and compare with what it was drawn with.

    Parameters
    ----------
    pair : tuple of arrays
        The images.
    mesh : Mesh
        Pixels.
    deformation : Deformation
        The truth.
    options : dict, optional
        Sections, as ``ddic.measure`` takes them.
    start : Result or pair of arrays, optional
        As ``ddic.measure`` takes it.

    Returns
    -------
    Measured
        Errors, or the refusal.
    """
    try:
        result = ddic.measure(pair, mesh, **{"start": start, **(options or {})})
    except ddic.DdicError as error:
        return Measured(np.nan, np.nan, str(error).splitlines()[0])
    off = result.at(mesh.nodes) - deformation.displacement(mesh.nodes)
    strain = compute_strain(result.mesh, result.displacement.ravel()).green_lagrange
    return Measured(float(np.sqrt(np.mean(off**2))), float(np.linalg.norm(off, axis=1).max()),
                    n_iterations=len(result.gauss_newton["iteration"]), largest_strain=float(np.abs(strain).max()))


def predict_floor(pair: Pair, mesh: ddic.Mesh, deformation: Deformation, noise: float) -> float:
    """Predict the RMS error that noise leaves, with the gradient of the deformed image.

    Parameters
    ----------
    pair : tuple of arrays
        The images.
    mesh : Mesh
        Pixels.
    deformation : Deformation
        The truth.
    noise : float
        Standard deviation, the images' grey levels.

    Returns
    -------
    float
        sqrt(2) sigma sqrt(mean diag M^-1), pixels.
    """
    image = MaskedSource(ArraySource(Path("memory"), np.asarray(pair[0], dtype=np.float32)))
    correlation = read_correlation(mesh, image, 3)
    moved = correlation.with_moved_gradient(deformation.displacement(mesh.nodes).ravel())
    factor = splu(moved.assemble_hessian().tocsc())
    diagonal = np.diag(factor.solve(np.eye(mesh.n_dofs)))
    return float(np.sqrt(2 * noise**2 * diagonal.mean()))


NOISE = 1.0
"""Standard deviation of the images' noise, grey levels."""

REPEATABLE = '[solver]\nmethod = "dual"\n'
"""Settings of two runs that are compared bit by bit. Left open, small cases on several ranks are given to MUMPS, which
adds up what ranks send in the order in which it comes: its last bits differ between any two runs."""


@dataclass(frozen=True)
class Frames:
    """A series of frames.

    Attributes
    ----------
    size : (width, height)
        Pixels.
    n_frames : int
        Deformed images.
    largest : float
        Displacement in the last one, pixels.
    """

    size: tuple[int, int]
    n_frames: int
    largest: float

    def make_deformation(self, number: int) -> Deformation:
        """Make the deformation of a frame."""
        share = self.largest * number / self.n_frames
        centre = np.array(self.size) / 2

        def displacement(points: Array) -> Array:
            x, y = ((points - centre) / centre).T
            along, across = 0.7 * np.sin(1.4 * x) + 0.2 * np.cos(2 * y), 0.5 * y * np.cos(x)
            return np.asarray(share * np.stack([along, across], axis=1))

        return Deformation(displacement)


def write_frames(frames: Frames, folder: Path) -> None:
    """Write the images that are not there already: reference.tif and frame_1.tif, frame_2.tif, ..."""
    stamp = folder / "frames.json"
    wanted = json.dumps([asdict(frames), source_version()])
    if not stamp.is_file() or stamp.read_text(encoding="utf-8") != wanted:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        stamp.write_text(wanted, encoding="utf-8")
    missing = [number for number in range(frames.n_frames + 1) if not _name(folder, number).is_file()]
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        list(pool.map(partial(_write_frame, frames, folder), missing))


def _name(folder: Path, number: int) -> Path:
    return folder / (f"frame_{number}.tif" if number else "reference.tif")


def _write_frame(frames: Frames, folder: Path, number: int) -> None:
    reference, deformed = render_deformed(frames.make_deformation(number), Camera(frames.size, NOISE))
    path = _name(folder, number)
    unfinished = path.with_suffix(".unfinished")
    tifffile.imwrite(unfinished, deformed if number else reference)
    unfinished.rename(path)


def describe_case(frames: Frames, element: float) -> str:
    """Give the case of a series.

    Parameters
    ----------
    frames : Frames
        Of the images.
    element : float
        Side of the elements, pixels.

    Returns
    -------
    str
        TOML text without ``[output]``.
    """
    margin = 2 * element
    region = [margin, margin, frames.size[0] - margin, frames.size[1] - margin]
    return f"""
[images]
reference = "reference.tif"
deformed = "frame_*.tif"
[mesh.structured]
region = {region}
element_size = {element}
"""

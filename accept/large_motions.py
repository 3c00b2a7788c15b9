"""Rotations, strains, necks in one pair and over 60 frames, small regions in large images: with default settings."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

import ddic
from accept.support.deformed_pair import (
    Camera,
    Deformation,
    make_linear,
    make_rotation,
    measure_deformed,
    predict_floor,
    render_deformed,
)
from accept.table import Scale
from bench.support.rows import Row, append_result

Array = NDArray[np.float64]

SIDE, REGION, ELEMENT = 1000, 260, 20
"""Sides of the images, of the region in their middle, which stays in the image turned and shifted, and of the elements,
pixels."""

SHIFT = 0.3
"""Share of the image's side by which the region moves as well."""

AT_REST, OF_FLOOR = 1.1, 1.15
"""Largest RMS error, times that at rest, or times the noise floor."""

SMOKE_ANGLES, ANGLES = (37.0,), tuple(float(angle) for angle in range(0, 181, 5))
SCALES = (0.8, 0.9, 1.1, 1.25)
STRAINS: Mapping[str, tuple[tuple[float, float], tuple[float, float]]] = {
    "strain of 10 %": ((0.1, 0.0), (0.0, -0.03)), "strain of 20 %": ((0.2, 0.0), (0.0, -0.06)),
    "strain of 40 %": ((0.4, 0.0), (0.0, -0.1)), "strain of -30 %": ((-0.3, 0.0), (0.0, 0.1)),
    "shear of 0.3": ((0.0, 0.3), (0.0, 0.0)),
}

GAUGE, NECK_HEIGHT = (200, 800), 800
"""Narrow gauge, pixels."""

FREE_ANGLES, WAVELENGTH, LARGEST_STRAIN = (1.0, 3.0, 10.0, 45.0), 256.0, 2e-4


def measure_rotations(scale: Scale) -> list[Row]:
    """Measure rotations with and without a shift, and scales."""
    angles = SMOKE_ANGLES if scale.smoke else ANGLES
    shifted = np.array([SHIFT * SIDE, 0.0])
    rows = [_judge_linear(f"rotation by {angles[0]:g} to {angles[-1]:g} degrees, {what}",
                          {f"{angle:g} degrees": (make_rotation(angle), shift) for angle in angles})
            for what, shift in (("without a shift", None), (f"shifted by {SHIFT:.0%} of the image", shifted))]
    if not scale.smoke:
        rows.append(_judge_linear("scale 0.8 to 1.25", {
            f"scale {s:g}": (make_rotation(0.0, s), None) for s in SCALES}))
    return rows


def measure_strains(scale: Scale) -> list[Row]:
    """Measure homogeneous strains and shear."""
    chosen = dict(list(STRAINS.items())[-1:] if scale.smoke else STRAINS.items())
    return [_judge_linear("homogeneous strain to 40 %, shear to 0.3", {
        name: (np.array(gradient), None) for name, gradient in chosen.items()})]


def _judge_linear(what: str, cases: Mapping[str, tuple[Array, Array | None]]) -> Row:
    """RMS errors beside that of the same mesh at rest, and beside the noise floor."""
    mesh, centre, camera = _mesh_in_the_middle(), np.full(2, SIDE / 2), Camera((SIDE, SIDE))
    still = make_linear(np.zeros((2, 2)), centre)
    at_rest = measure_deformed(render_deformed(still, camera), mesh, still).rms
    worst, worst_name, refused = 0.0, "", []
    for name, (gradient, translation) in cases.items():
        deformation = make_linear(gradient, centre, translation)
        pair = render_deformed(deformation, camera)
        found = measure_deformed(pair, mesh, deformation)
        append_result("start_runs", {"case": f"{what}: {name}", "rms": found.rms, "at_rest": at_rest,
                                     "refusal": found.refusal})
        if not found.converged:
            refused.append(name)
            continue
        allowed = max(AT_REST * at_rest, OF_FLOOR * predict_floor(pair, mesh, deformation, camera.noise))
        if found.rms / allowed > worst:
            worst, worst_name = found.rms / allowed, f"{name}, {found.rms:.4f} px"
    told = f"at most {worst:.2f} of what is allowed ({worst_name}; at rest {at_rest:.4f} px)"
    if refused:
        told += f"; not converged: {', '.join(refused)}"
    return Row(f"{what}, noise of {camera.noise:g} grey levels, {ELEMENT}-px elements", "all converge, RMS error at "
               f"most {AT_REST} times that at rest or {OF_FLOOR} times the noise floor", told,
               not refused and worst <= 1)


def _mesh_in_the_middle() -> ddic.Mesh:
    low, high = (SIDE - REGION) / 2, (SIDE + REGION) / 2
    return ddic.structured_mesh((low, low, high, high), ELEMENT)


def measure_neck(scale: Scale) -> list[Row]:
    """Measure a narrow gauge that necks."""
    rows = []
    for wavelength in (None,) if scale.smoke else (None, 60.0, 300.0):
        options = {} if wavelength is None else {"regularization": {"cut_off_wavelength": wavelength}}
        told, converged = [], True
        for width in (40.0,) if scale.smoke else (40.0, 80.0, 140.0):
            deformation = make_neck(width)
            ends = np.array([[200.0, 100.0], [200.0, 100.0 + NECK_HEIGHT]])
            elongation = float(np.ptp(deformation.displacement(ends)[:, 1]))
            pair = render_deformed(deformation, Camera((400, SIDE)))
            mesh = ddic.structured_mesh((100, 100, 300, 100 + NECK_HEIGHT), 12)
            found = measure_deformed(pair, mesh, deformation, options)
            converged &= found.converged
            told.append(f"{elongation:.0f} px: " + (f"{found.n_iterations} iterations, RMS {found.rms:.3f} px"
                                                    if found.converged else "not converged"))
        length = "without regularization" if wavelength is None else f"l_c = {wavelength:g} px"
        rows.append(Row(f"gauge of {GAUGE[0]} x {GAUGE[1]} px, strain of 1 % and a neck of 20 %, noise of 2 grey "
                        f"levels, {length}", "converges in one pair", "; ".join(told), converged))
    return rows


def make_neck(width: float, share: float = 1.0) -> Deformation:
    """Make a strain of 1 % along y with a Gaussian neck of 20 %.

    Parameters
    ----------
    width : float
        Standard deviation of the neck, pixels.
    share : float
        Of the displacement.

    Returns
    -------
    Deformation
        Narrower by 0.4 of the strain.
    """

    def displacement(points: Array) -> Array:
        y = points[:, 1] - SIDE / 2
        bulge = 0.2 * width * np.sqrt(np.pi / 2) * erf(y / (np.sqrt(2) * width))
        strain = 0.01 + 0.2 * np.exp(-(y**2) / (2 * width**2))
        return np.asarray(share * np.stack([-0.4 * strain * (points[:, 0] - 200), 0.01 * y + bulge], axis=1))

    return Deformation(displacement)


def measure_free_rotation(scale: Scale) -> list[Row]:
    """Measure rigid rotations whose free edges are controlled."""
    controlled: dict[str, Any] = {"regularization": {"cut_off_wavelength": WAVELENGTH, "not_controlled": []}}
    told, holds = [], True
    for degrees in FREE_ANGLES[:1] if scale.smoke else FREE_ANGLES:
        deformation = make_linear(make_rotation(degrees), np.full(2, SIDE / 2), np.array([3.3, -2.1]))
        pair = render_deformed(deformation, Camera((SIDE, SIDE), noise=0.0))
        mesh = _mesh_in_the_middle()
        plain, free = (measure_deformed(pair, mesh, deformation, options) for options in ({}, controlled))
        holds &= bool(free.rms <= plain.rms and free.largest_strain <= LARGEST_STRAIN)
        told.append(f"{degrees:g} degrees: {free.rms:.4f} px ({plain.rms:.4f} without), strain "
                    f"{free.largest_strain:.1e}")
    return [Row(f"rigid rotation, free edges controlled, l_c = {WAVELENGTH:g} px, no noise", "RMS error no larger than "
                f"without regularization, largest strain {LARGEST_STRAIN:.0e}", "; ".join(told), holds)]


N_FRAMES, NECK_WIDTH = 60, 140.0
STRIDES = (1, 2, 5)
RIGHT_PX = 0.5
"""Largest error of a node in the last frame, pixels; noise of 2 grey levels leaves 0.1 px at a corner."""


def measure_neck_series(scale: Scale) -> list[Row]:
    """Measure a series, each frame from the one before."""
    mesh = ddic.structured_mesh((100, 100, 300, 100 + NECK_HEIGHT), 12)
    camera = Camera((400, SIDE))
    numbers = range(30, 61, 30) if scale.smoke else range(1, N_FRAMES + 1)
    reference = render_deformed(make_neck(NECK_WIDTH, 0.0), camera)[0]
    frames = {n: render_deformed(make_neck(NECK_WIDTH, n / N_FRAMES), camera)[1] for n in numbers}
    rows = []
    for stride in STRIDES[-1:] if scale.smoke else STRIDES:
        chosen = [n for n in frames if n % stride == 0]
        n_iterations, told, holds = 0, "", False
        result: ddic.Result | None = None
        with ddic.prepare(reference, mesh) as session:
            for n in chosen:
                try:
                    result = session.measure(frames[n], start=result)
                except ddic.DdicError as error:
                    told = f"frame {n}: {str(error).splitlines()[0]}"
                    break
                n_iterations += len(result.gauss_newton["iteration"])
            if result is not None and not told:
                off = result.at(mesh.nodes) - make_neck(NECK_WIDTH, chosen[-1] / N_FRAMES).displacement(mesh.nodes)
                largest = float(np.linalg.norm(off, axis=1).max())
                holds = largest <= RIGHT_PX
                told = (f"frame {chosen[-1]} reached, {n_iterations / len(chosen):.1f} iterations a frame, RMS error "
                        f"{np.sqrt(np.mean(off**2)):.3f} px, largest {largest:.2f} px")
        rows.append(Row(f"neck of 20 % over {N_FRAMES} frames, each from the last, every {stride} measured",
                        f"reaches the last frame, no node off by more than {RIGHT_PX} px", told, holds))
    return rows


SIZE, SMOKE_SIZE = (6576, 4384), (2000, 2000)
"""Width and height of the large image, pixels."""

NECKS = (40.0, 140.0)
MOST_TIMES_ALONE = 1.01
"""Standard deviations of the necks, pixels, and the RMS error beside that in a small image: nothing but the start
differs, and where that is good enough Gauss-Newton forgets it."""


def measure_small_region(scale: Scale) -> list[Row]:
    """Measure the narrow gauge that necks where it is a part of a large image."""
    width, height = SMOKE_SIZE if scale.smoke else SIZE
    origin = np.array([width // 2, height // 3])
    gauge = np.array([100.0, 100.0, 300.0, 100.0 + NECK_HEIGHT])
    told, holds = [], True
    for neck in NECKS[:1] if scale.smoke else NECKS:
        deformation = make_neck(neck)
        pair = render_deformed(deformation, Camera((400, SIDE)))
        alone = measure_deformed(pair, ddic.structured_mesh(tuple(gauge), 12), deformation)
        large = tuple(_surround(image, (height, width), origin, seed) for seed, image in enumerate(pair))
        moved = Deformation(partial(_displace_from, deformation, origin))
        mesh = ddic.structured_mesh(tuple(gauge + np.tile(origin, 2)), 12)
        found = measure_deformed((large[0], large[1]), mesh, moved)
        holds &= found.converged and found.rms <= MOST_TIMES_ALONE * alone.rms
        told.append(f"neck of {neck:g} px: " + (f"{found.rms:.4f} px ({alone.rms:.4f} px in an image of its own)"
                                                if found.converged else f"not converged: {found.refusal}"))
    return [Row(f"a gauge of {GAUGE[0]} x {GAUGE[1]} px with a neck of 20 % in an image of {width} x {height} px",
                f"converges, RMS error at most {MOST_TIMES_ALONE:g} times that in an image of its own", "; ".join(told),
                holds)]


def _surround(image: NDArray[Any], shape: tuple[int, int], origin: NDArray[np.int64], seed: int) -> NDArray[np.uint8]:
    """A large image of noise, with another one in it."""
    large = np.random.default_rng(seed).integers(58, 63, shape, dtype=np.uint8)
    large[origin[1]:origin[1] + image.shape[0], origin[0]:origin[0] + image.shape[1]] = image
    return large


def _displace_from(deformation: Deformation, origin: NDArray[np.int64], points: NDArray[np.float64],
                   ) -> NDArray[np.float64]:
    return deformation.displacement(points - origin)

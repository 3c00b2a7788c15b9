"""Checks of the near/far table on real foam: joint field against full resolution, beside what noise makes of that.

The far camera under-samples the foam. ``foam`` compares, ``foam_noise`` adds known noise to the pictures,
``foam_sampling`` shifts full-resolution images by whole pixels before they are reduced.
"""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from accept.support.foam_noise import (
    OFFSET,
    RATIO,
    DifferenceNoise,
    ShiftError,
    VectorRms,
    draw_vector_rms,
    foam_case,
    foam_pairs,
    measure_shifts,
    name_pair,
    predict_difference_noise,
)
from accept.table import Scale, runs_name
from bench.support.near_far_case import Alone, Pair, alpha_of, calibrate_command, measured_alone
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_run, environment
from ddic.io.result_reader import Result, read_result
from ddic.mesh.mesh import Mesh
from ddic.start.frame_start import ROUNDING

RUNS = runs_name("near-far")
N_RANKS = 2
ELEMENTS = (12, 16, 20)
FIELD_PX, ALPHA_PX, CALIBRATION_PX = 0.05, 0.05, 0.1
CONFIDENCE = 0.95
"""Probability with which noise of the predicted covariance leaves less than what still passes for noise."""

ADDED_SHARE = 0.5
"""Of the estimated noise, what is added to the pictures: a larger share stands out more, and is less small."""

N_NOISY, SIGMAS = 16, 3.0
KEEP = '[correlation]\nspoilt_pixels = "keep"\n'
"""All pixels count in every draw: the prediction knows of no other, and a measurement that finds a cell spoilt in one
draw has no field there."""

N_PLACES = 3
"""Places of the mesh along each axis, a share of an element apart."""

SAMPLING_SHARE = (0.6, 1.2)
"""Of the error predicted of white noise, what sampling may leave. What interpolation misses alternates from pixel to
pixel, where grad f is weak: white noise of the same size does more harm, and the prediction is an upper estimate."""

ROUGH_RATIOS = (3.6, 4.4)
DEGREES = {"cubic (default)": 3, "quintic": 5}


@dataclass(frozen=True)
class Compared:
    """A joint measurement, the near images alone, and what noise makes of their difference.

    Attributes
    ----------
    joint : Result
        Joint measurement.
    difference : (n, 2) array
        Joint field less that of the near images alone, full-resolution px.
    far_noise, near_noise : float
        Grey levels, by which the cameras were weighted.
    """

    joint: Result
    difference: NDArray[np.float64]
    far_noise: float
    near_noise: float

    @property
    def vector_rms(self) -> float:
        """Of the difference, full-resolution px."""
        return float(np.sqrt((self.difference**2).sum(axis=1).mean()))

    @property
    def weight(self) -> float:
        """Of the near camera."""
        return (self.far_noise / self.near_noise)**2

    def predict(self) -> DifferenceNoise:
        """Propagate noise through the operators of both measurements."""
        return predict_difference_noise(self.joint.path.with_suffix(".toml"), self.joint, self.weight)


def measure_foam(scale: Scale) -> list[Row]:
    """Compare the joint field on real images with the near images measured alone, the full-resolution ones there."""
    far, near = foam_pairs()
    folder = scale.folder("near_far")
    sizes = ELEMENTS[-1:] if scale.smoke else ELEMENTS
    return [*(_judge(_compare(far, near, size, folder), size) for size in sizes),
            _judge_use_far(far, near, sizes[0], folder), _calibration(far, near)]


def _compare(far: Pair, near: Pair, size: int, folder: Path, rest: str = "", *, use_far: bool = False) -> Compared:
    name = f"foam_{size}"
    summary = ddic_run(foam_case(far, near, size, rest=rest, use_far=use_far), folder, N_RANKS, name)
    append_result(RUNS, {"run": name, **summary})
    joint = read_result(folder / f"{name}.vtkhdf")
    alone: Alone = measured_alone(joint, 1, near, folder, rest)
    of_near = joint.attributes["near_1"]
    return Compared(joint, RATIO * (joint.displacement[alone.nodes] - alone.seen), float(of_near["far_noise_grey"]),
                    float(of_near["noise_grey"]))


def _judge(compared: Compared, size: int) -> Row:
    """The difference, against the bound or, where noise alone is above the bound, against noise."""
    noise = compared.predict()
    expected = draw_vector_rms(noise.covariance(compared.far_noise, compared.near_noise))
    # What the far camera would have, were it as good as the mean of near pixels that it is made of.
    of_camera = draw_vector_rms(noise.covariance(float(np.hypot(compared.near_noise / RATIO, ROUNDING)),
                                                 compared.near_noise))
    alpha = alpha_of(compared.joint)
    spread = np.sqrt(np.diag(noise.alpha_covariance(compared.far_noise, compared.near_noise)))
    common = compared.difference.mean(axis=0)
    about = float(np.sqrt(((compared.difference - common)**2).sum(axis=1).mean()))
    append_result(RUNS, {"check": "foam", "element_size": size, "vector_rms_px": compared.vector_rms,
                         "predicted_std_px": expected.std, "likely_below_px": expected.likely_below(CONFIDENCE),
                         "camera_std_px": of_camera.std, "common_px": common.tolist(), "about_common_px": about,
                         "alpha_px": alpha.tolist(), "alpha_std_px": spread.tolist()})
    return Row(
        f"nearfar_foam, elements of {size} far px, default settings: joint field against the full-resolution (near) "
        "images measured alone on the same elements, alpha left out of neither; vector RMS",
        f"<= {FIELD_PX} full-resolution px; or, where the standard deviation predicted of noise is itself above that, "
        f"what noise stays below with a probability of {CONFIDENCE:.0%}; alpha = 0 within {ALPHA_PX} far px",
        f"{compared.vector_rms:.4f} full-resolution px at {len(compared.difference)} nodes; predicted standard "
        f"deviation {expected.std:.4f}, {CONFIDENCE:.0%} below {expected.likely_below(CONFIDENCE):.4f}, "
        f"{expected.share_above(compared.vector_rms):.0%} above the measured, of noise of {compared.far_noise:.2f} "
        f"(far) and {compared.near_noise:.2f} grey levels; {of_camera.std:.4f} were the far noise the near one over "
        f"{RATIO}; one vector common to all nodes but {about:.4f}; alpha = ({alpha[0]:.4f} +- {spread[0]:.4f}, "
        f"{alpha[1]:.4f} +- {spread[1]:.4f}) far px",
        _is_explained(compared.vector_rms, expected) and float(np.abs(alpha).max()) <= ALPHA_PX)


def _judge_use_far(far: Pair, near: Pair, size: int, folder: Path) -> Row:
    """The difference where the far images measure the near elements too, and what a quintic spline makes of it."""
    told, rms = [], {}
    for name, degree in DEGREES.items():
        spline = f"[correlation]\nspline_degree = {degree}\n"
        compared = _compare(far, near, size, folder / "use_far", spline, use_far=True)
        alpha = alpha_of(compared.joint)
        spread = np.sqrt(np.diag(compared.joint.attributes["near_1"]["covariance"]))
        rms[degree] = compared.vector_rms
        append_result(RUNS, {"check": "foam", "element_size": size, "use_far": True, "spline": name,
                             "vector_rms_px": compared.vector_rms, "alpha_px": alpha.tolist(),
                             "alpha_std_px": spread.tolist()})
        told.append(f"{name} {compared.vector_rms:.4f} full-resolution px, alpha = ({alpha[0]:.4f} +- {spread[0]:.4f}, "
                    f"{alpha[1]:.4f} +- {spread[1]:.4f}) far px")
    return Row(f"nearfar_foam, elements of {size} far px, use_far = true: the same difference; vector RMS",
               f"<= {FIELD_PX} full-resolution px with the default spline; the other one measured", "; ".join(told),
               rms[DEGREES["cubic (default)"]] <= FIELD_PX)


def _is_explained(vector_rms: float, expected: VectorRms) -> bool:
    forbidden_by_noise = expected.std > FIELD_PX
    return vector_rms <= FIELD_PX or (forbidden_by_noise and vector_rms <= expected.likely_below(CONFIDENCE))


def measure_foam_places(scale: Scale) -> list[Row]:
    """Place the finest mesh elsewhere by thirds of an element: other elements along the interface, another alpha."""
    far, near = foam_pairs()
    size = ELEMENTS[-1] if scale.smoke else ELEMENTS[0]
    shares = [place * size // N_PLACES for place in range(N_PLACES)]
    offsets = [(x, y) for x in shares for y in shares][:2 if scale.smoke else None]
    cases = [foam_case(far, near, size, offset) for offset in offsets]
    folder = scale.folder("near_far") / "placed"
    measured = [joint for case in cases if (joint := _run_unless_slow(case, folder)) is not None]
    found = RATIO * np.array([alpha_of(joint) for joint in measured])
    predicted = RATIO**2 * np.array([np.diag(joint.attributes["near_1"]["covariance"]) for joint in measured])
    lengths = np.hypot(*found.T)
    rms, std = (float(np.sqrt(squares.sum(axis=1).mean())) for squares in (found**2, predicted))
    append_result(RUNS, {"check": "foam_places", "element_size": size, "alpha_near_px": found.tolist(),
                         "predicted_std_px": std, "not_converged": len(cases) - len(measured)})
    return [Row(
        f"nearfar_foam, elements of {size} far px, mesh placed at {len(offsets)} offsets: alpha, which is the "
        "difference of the check foam; RMS length over offsets",
        f"<= {FIELD_PX} full-resolution px, or the predicted standard deviation where that is larger",
        f"{rms:.4f} full-resolution px, predicted {std:.4f}; from {lengths.min():.4f} to {lengths.max():.4f}, "
        f"{(lengths <= FIELD_PX).sum()} of {len(lengths)} below {FIELD_PX}; "
        f"{len(cases) - len(measured)} more did not converge",
        rms <= max(FIELD_PX, std))]


def _run_unless_slow(case: str, folder: Path) -> Result | None:
    """Run a case; nothing where Gauss-Newton needs too many iterations, as a cell on a hole's dark edge may."""
    try:
        ddic_run(case, folder, N_RANKS)
    except RuntimeError as error:
        if "did not converge" not in str(error):
            raise
        return None
    return read_result(folder / "result.vtkhdf")


def measure_foam_noise(scale: Scale) -> list[Row]:
    """Add known noise to all four pictures, again and again, and see how far the difference moves."""
    far, near = foam_pairs()
    folder = scale.folder("near_far") / "noisy"
    size, n_draws = (ELEMENTS[-1], 2) if scale.smoke else (ELEMENTS[0], N_NOISY)
    estimated = _compare(far, near, size, folder, KEEP)
    # The same weights in all runs.
    far = replace(far, noise=estimated.far_noise)
    near = replace(near, noise=estimated.near_noise)
    clean = _compare(far, near, size, folder, KEEP)
    noise = clean.predict()
    added = ADDED_SHARE * clean.far_noise, ADDED_SHARE * clean.near_noise
    predicted = draw_vector_rms(noise.covariance(*added)).std
    alpha_std = np.sqrt(np.diag(noise.alpha_covariance(clean.far_noise, clean.near_noise)))
    off = float(np.abs(np.sqrt(np.diag(clean.joint.attributes["near_1"]["covariance"])) / alpha_std - 1).max())
    rng = np.random.default_rng(1)
    moved = []
    for _ in range(n_draws):
        pairs = [_add_noise(pair, folder, name, rng) for pair, name in ((far, "far"), (near, "near"))]
        moved.append(_compare(pairs[0], pairs[1], size, folder, KEEP).difference - clean.difference)
    scatter = float(np.sqrt((np.array(moved)**2).sum(axis=2).mean()))
    # Alpha's two components in every draw are all that varies much.
    within = SIGMAS / np.sqrt(2 * 2 * n_draws)
    append_result(RUNS, {"check": "foam_noise", "element_size": size, "scatter_px": scatter, "predicted_px": predicted,
                         "alpha_std_off": off, "draws": n_draws})
    return [Row(
        f'nearfar_foam, elements of {size} far px, spoilt_pixels = "keep", noise of {added[0]:.2f} (far) and '
        f"{added[1]:.2f} grey levels added to all pictures, {n_draws} times: by how much the difference of the check "
        "foam changes; vector RMS",
        f"the predicted standard deviation within {within:.0%}, {SIGMAS:g} standard deviations of that many draws; "
        "ddic's standard deviation of alpha the predicted one within 1 %",
        f"{scatter:.4f} full-resolution px, predicted {predicted:.4f}; alpha's standard deviation off by {off:.1e}",
        bool(abs(scatter / predicted - 1) <= within and off <= 0.01))]


def _add_noise(pair: Pair, folder: Path, name: str, rng: np.random.Generator) -> Pair:
    """Pictures in floating point, so that nothing is cut off at black or white."""
    noisy = name_pair(pair, folder, name)
    for origin, copy in ((pair.reference, noisy.reference), (pair.deformed, noisy.deformed)):
        image = tifffile.imread(origin)
        added = rng.normal(0.0, ADDED_SHARE * (pair.noise or 0.0), image.shape)
        tifffile.imwrite(copy, (image + added).astype(np.float32))
    return noisy


def measure_foam_sampling(scale: Scale) -> list[Row]:
    """Shift the near reference image by whole pixels, reduce both to far pixels, and measure the known shift."""
    far, near = foam_pairs()
    size = ELEMENTS[-1] if scale.smoke else ELEMENTS[0]
    joint = _compare(far, near, size, scale.folder("near_far")).joint
    image = tifffile.imread(near.reference).astype(float)
    mesh = _see_reduced(joint, near)
    found = {name: list(measure_shifts(image, mesh, RATIO, degree)) for name, degree in DEGREES.items()}
    told, holds = [], True
    for name, errors in found.items():
        measured = float(np.sqrt(np.mean([(e.error**2).sum(axis=1).mean() for e in errors])))
        predicted = float(np.sqrt(np.mean([e.predicted**2 for e in errors])))
        bias, residual = _bias(errors), float(np.sqrt(np.mean([e.residual_std**2 for e in errors])))
        append_result(RUNS, {"check": "foam_sampling", "element_size": size, "spline": name, "rms_px": measured,
                             "predicted_px": predicted, "bias_px": bias, "residual_std_grey": residual})
        told.append(f"{name}: residual {residual:.1f} grey levels, error {measured:.3f} full-resolution px, predicted "
                    f"{predicted:.3f}, of which {bias:.3f} at quarters of a far px is common to all nodes")
        holds &= SAMPLING_SHARE[0] <= measured / predicted <= SAMPLING_SHARE[1]
    return [Row(
        f"nearfar_foam, near reference image against itself shifted by 1 to {RATIO - 1} whole px, both reduced "
        f"{RATIO} x {RATIO}: the far camera alone on elements of {size} far px, nothing but sampling and rounding; "
        "vector RMS",
        f"{SAMPLING_SHARE[0]:g} to {SAMPLING_SHARE[1]:g} times the error predicted of white noise as large as the "
        "residual",
        "; ".join(told), bool(holds))]


def _see_reduced(joint: Result, near: Pair) -> Mesh:
    """The near camera's elements in pixels of its image reduced to far px, of which the first is left out."""
    part, _ = joint.mesh.create_submesh(np.flatnonzero(joint.cell_data["Camera"] == 1))
    middle = (RATIO - 1) / 2
    nodes = (near.mapping.to_image(part.nodes) - middle) / RATIO - 1
    return Mesh(nodes, part.connectivity, part.offsets, part.types)


def _bias(errors: list[ShiftError]) -> float:
    """Mean error of nodes along shifts by a quarter of a far px, towards no shift: mean over axes and directions."""
    towards = []
    for e in errors:
        for axis in range(2):
            if e.shift[axis] in (1, RATIO - 1) and e.shift[1 - axis] == 0:
                sign = 1 if e.shift[axis] == 1 else -1
                towards.append(-sign * float(e.error[:, axis].mean()))
    return float(np.mean(towards))


def _calibration(far: Pair, near: Pair) -> Row:
    """What ddic calibrate prints from ratios 10 % off on either side."""
    worst = np.zeros(3)
    for rough in ROUGH_RATIOS:
        printed = subprocess.run(calibrate_command(far.reference, near.reference, rough), check=True,
                                 env=environment(), capture_output=True, text=True, timeout=600).stdout
        ratio, _ = _numbers_after("ratio", printed)[:2]
        x, _, y, _ = _numbers_after("offset", printed)[:4]
        off = np.abs(np.array([ratio, x, y]) - (RATIO, *OFFSET))
        append_result(RUNS, {"check": "foam", "rough_ratio": rough, "ratio": ratio, "offset": [x, y]})
        worst = np.maximum(worst, off)
    across = worst[0] * _far_width(near)
    return Row(f"nearfar_foam: ddic calibrate --ratio {' and '.join(map(str, ROUGH_RATIOS))}",
               f"ratio {RATIO} within {CALIBRATION_PX} near px over the near image; offsets {OFFSET} "
               f"within {CALIBRATION_PX} near px",
               f"ratio off by {worst[0]:.1e}, {across:.4f} near px; offsets by {worst[1]:.4f}, {worst[2]:.4f} near px",
               bool(max(across, worst[1], worst[2]) <= CALIBRATION_PX))


def _far_width(pair: Pair) -> float:
    """Width of a camera's image in far px."""
    with tifffile.TiffFile(pair.reference) as file:
        return float(file.pages[0].shape[1] / pair.mapping.homography[0, 0])


def _numbers_after(name: str, printed: str) -> list[float]:
    line = next(line for line in printed.splitlines() if re.match(rf"{name} {{2}}", line))
    return [float(found) for found in re.findall(r"(?<![\w(])-?\d+\.\d+", line)]

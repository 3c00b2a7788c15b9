"""The acceptance table of near and far images: every check measured here and now; exit 1 where one falls short.

``make accept-near-far``, a check alone with CHECK=NAME. Synthetic images are those of ``ddic synth near-far``: ratio 5,
1392 x 1040 px each, 8 bit, alpha = (3.7, -2.2) far px; meshes are of 16-px elements with the hole left out. The noise
check draws near_far.png into the folder of its files, a picture of the documentation.
"""

from __future__ import annotations

import dataclasses
import re
import subprocess
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from accept.table import Scale, runs_name
from bench.support.near_far_case import (
    Pair,
    Scene,
    calibrate_command,
    continuous,
    draw_panels,
    error_rms,
    errors,
    independent,
    interface_error,
    joint_case,
    largest_jump,
    measured_alone,
    oscillation,
    render_scene,
    rms,
)
from bench.support.rows import Row, append_result
from bench.support.runs import ddic_command, ddic_run, environment, run_job
from ddic.images.camera import CameraMapping, similarity
from ddic.io.result_reader import Result, read_result

TABLE = "near-far"
RUNS = runs_name(TABLE)
JOB = "accept.support.near_far_job"
N_RANKS, N_SUBDOMAINS = 2, 6
WAVELENGTH, NOISE = 96, 2.0
WITHOUT_NEAR = 0.43
"""Share of the far image's width, from the left, that does not show the near field."""

QUINTIC = "[correlation]\nspline_degree = 5\n"
GAP = f'[regularization]\ncut_off_wavelength = {WAVELENGTH}\nnot_controlled = ["left", "right", "top", "bottom"]\n'
VARIANTS = {"continuous": "", "regularized": GAP}
ALPHA_BOUND, ERROR_BOUND, JUMP_BOUND, DUAL_BOUND = 0.002, 0.003, 1e-10, 1e-9
EXACT_TOLERANCE = 1e-12
RANKS, CUTS = (1, 2, 3, 4), (4, 9)


def _scene(scale: Scale) -> Scene:
    """The images of the table, small ones in a smoke run."""
    folder = scale.folder("near_far")
    if scale.smoke:
        return Scene(480, 400, 3.0, (1.7, -1.2), 12.0, folder)
    return Scene(1392, 1040, 5.0, (3.7, -2.2), 16.0, folder)


def measure_exact(scale: Scale) -> list[Row]:
    """Measure alpha, error and jump on images without noise but their rounding to whole grey levels."""
    scene = _scene(scale)
    far, near, truth = render_scene(scene, 0)
    rows = []
    for name, gap in VARIANTS.items():
        solver = (f'[solver]\nmethod = "dual"\nsubdomains = {N_SUBDOMAINS}\ninexact = false\n'
                  f"tolerance = {EXACT_TOLERANCE}\n")
        case = joint_case(far, near, scene.plate(_truth_file(far)), QUINTIC + solver + gap)
        result = _run(case, scene.folder, f"exact_{name}")
        fields = continuous(result)
        off = float(np.abs(fields.alpha - scene.alpha).max())
        error = error_rms(fields, truth.displacement)
        jump = float(result.attributes["case"]["largest_jump_px"])
        rows.append(Row(
            f'synthetic pair, no noise, method = "dual", quintic spline, {_equation(name)}: alpha, displacement, jump '
            "across the interface",
            f"alpha within {ALPHA_BOUND} px; RMS error <= {ERROR_BOUND} px per component; jump <= {JUMP_BOUND:.0e} px",
            f"alpha off by {off:.5f} px; RMS error {error:.5f} px per component ({error * np.sqrt(2):.5f} px in "
            f"length); largest jump before copies are averaged {jump:.1e} px",
            off <= ALPHA_BOUND and error <= ERROR_BOUND and jump <= JUMP_BOUND,
            # Elements of 12 px, alone, have a larger error of rounding.
            judged_small=bool(gap)))
    return rows


def measure_noise(scale: Scale) -> list[Row]:
    """Measure error and oscillation of independent, continuous and regularized fields, on the same noisy images."""
    scene = _scene(scale)
    far, near, truth = render_scene(scene, NOISE)
    results = {}
    for name, gap in VARIANTS.items():
        case = joint_case(far, near, scene.plate(_truth_file(far)),
                          f'{QUINTIC}[solver]\nmethod = "dual"\nsubdomains = {N_SUBDOMAINS}\n{gap}')
        results[name] = _run(case, scene.folder, f"noise_{name}")
    alone = [measured_alone(results["continuous"], k, pair, scene.folder, f'{QUINTIC}[solver]\nmethod = "dual"\n')
             for k, pair in enumerate((far, near))]
    fields = {"independent": independent(results["continuous"], alone),
              **{name: continuous(result) for name, result in results.items()}}
    table = []
    for name, field in fields.items():
        by_camera = [rms(e) for e in errors(field, truth.displacement)]
        record = {"variant": name, "rms_error_px": error_rms(field, truth.displacement),
                  "far_rms_error_px": by_camera[0], "near_rms_error_px": by_camera[1],
                  "interface_rms_error_px": interface_error(field, truth.displacement),
                  "oscillation_px": oscillation(field, truth.displacement),
                  "largest_jump_px": largest_jump(field), "alpha_error_px": (field.alpha - scene.alpha).tolist()}
        append_result(RUNS, {"check": "noise", **record})
        table.append(record)
    draw_panels(fields, scene.folder / "near_far.png")
    falls = all(b[key] < a[key] for a, b in pairwise(table)
                for key in ("rms_error_px", "oscillation_px"))
    return [Row(f"the same with noise of {NOISE:g} grey levels: independent, continuous (Eq. 21), regularized "
                f"(Eq. 23, l_c = {WAVELENGTH} px); oscillation: RMS second difference of the error along the mesh "
                "lines through the interface's nodes", "RMS error and interface oscillation fall in that order",
                "; ".join(f"{r['variant']} {r['rms_error_px']:.5f}, {r['oscillation_px']:.5f} px" for r in table),
                falls)]


def measure_dual(scale: Scale) -> list[Row]:
    """Compare the dual step on 1 to 4 ranks with the saddle point of Eq. 21 and one gap, solved by a sparse LU."""
    scene = _scene(scale)
    far, near, _ = render_scene(scene, NOISE)
    far, near = (dataclasses.replace(pair, noise=NOISE) for pair in (far, near))
    cases = []
    for name, gap in VARIANTS.items():
        for n_subdomains in CUTS[:1] if scale.smoke else CUTS:
            solver = f'[solver]\nmethod = "dual"\nsubdomains = {n_subdomains}\ntolerance = {EXACT_TOLERANCE}\n'
            cases.append(scene.folder / f"dual_{name}_{n_subdomains}.toml")
            cases[-1].write_text(joint_case(far, near, scene.plate(_truth_file(far)), solver + gap),
                                 encoding="utf-8")
    found: list[dict[str, Any]] = []
    ranks = RANKS[1:2] if scale.smoke else RANKS
    for n_ranks in ranks:
        found += run_job(n_ranks, JOB, str(_truth_file(far)), *map(str, cases))
    for record in found:
        append_result(RUNS, {"check": "dual", **record})
    largest = max(r["relative_difference"] for r in found)
    alpha = max(r["alpha_difference"] for r in found)
    return [Row(f"dual step, {_listed(CUTS)} subdomains on {_listed(RANKS)} ranks, without and with regularization, "
                "against the saddle point of Eq. 21 with the whole region's gap solved directly",
                f"relative difference <= {DUAL_BOUND:.0e}",
                f"largest of {len(found)}: displacement {largest:.1e}, alpha {alpha:.1e}",
                len(found) == len(ranks) * len(cases) and max(largest, alpha) <= DUAL_BOUND)]


def measure_wrong_inputs(scale: Scale) -> list[Row]:
    """Give wrong inputs to ddic calibrate and ddic run: exit code 2 and one line that says what is wrong."""
    import tifffile

    scene = _scene(scale)
    far, near, _ = render_scene(scene, 0)
    other = render_scene(scene, 0, seed=5)[1].reference
    cut, ratio = scene.folder / "far_without_near.tif", scene.ratio
    tifffile.imwrite(cut, tifffile.imread(far.reference)[:, :round(WITHOUT_NEAR * scene.width)])
    away = similarity(ratio, 0.0, (2000.0, float(near.mapping.homography[1, 2])))
    twice = _similarity_about_centre(near, 2 * ratio)
    stranger = dataclasses.replace(near, reference=other)
    give_ratio = rf"give --ratio {ratio:g}\b"
    not_found, no_such_thing = r"was not found|lies outside", r"does not show what the far-field image"
    misplaced = dataclasses.replace(near, mapping=away)
    too_large = dataclasses.replace(near, mapping=twice)
    asked = {
        "calibrate: near image outside the far one": (calibrate_command(cut, near.reference, ratio), not_found),
        "run: near image outside the far one": (_refused(scene, far, misplaced, "outside"),
                                                r"lies outside the far-field image"),
        "calibrate: ratio too large by 2": (calibrate_command(far.reference, near.reference, 2 * ratio), give_ratio),
        "calibrate: ratio too small by 2": (calibrate_command(far.reference, near.reference, ratio / 2), give_ratio),
        "run: ratio too large by 2": (_refused(scene, far, too_large, "ratio"), no_such_thing),
        "calibrate: no common texture": (calibrate_command(far.reference, other, ratio), r"no common texture"),
        "run: no common texture": (_refused(scene, far, stranger, "texture"), no_such_thing),
    }
    failed = []
    for what, (command, expected) in asked.items():
        done = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=600, check=False)
        lines = done.stderr.strip().splitlines()
        append_result(RUNS, {"check": "errors", "input": what, "exit_code": done.returncode, "lines": lines})
        if done.returncode != 2 or len(lines) != 1 or not re.search(expected, lines[0]):
            failed.append(f"{what}: exit code {done.returncode}, {done.stderr.strip()[:200]!r}")
    return [Row("wrong inputs: " + "; ".join(asked), "exit code 2 and one line that says what is wrong",
                f"{len(asked) - len(failed)} of {len(asked)} so" + "".join(f"; {f}" for f in failed), not failed)]


def _run(case: str, folder: Path, name: str) -> Result:
    summary = ddic_run(case, folder, N_RANKS, name)
    append_result(RUNS, {"run": name, **summary})
    return read_result(folder / f"{name}.vtkhdf")


def _truth_file(far: Pair) -> Path:
    return far.reference.parent / "truth.json"


def _equation(variant: str) -> str:
    return "continuous (Eq. 21)" if variant == "continuous" else f"regularized (Eq. 23, l_c = {WAVELENGTH} px)"


def _similarity_about_centre(near: Pair, ratio: float) -> CameraMapping:
    """A mapping of another ratio that leaves the centre of the near field where it is."""
    import tifffile

    with tifffile.TiffFile(near.reference) as file:
        height, width = file.pages[0].shape
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    focus = near.mapping.to_specimen(middle[None])[0]
    return similarity(ratio, 0.0, tuple(middle - ratio * focus))


def _refused(scene: Scene, far: Pair, near: Pair, name: str) -> list[str]:
    """The command that runs a case that should be refused."""
    path = scene.folder / f"wrong_{name}.toml"
    path.write_text(joint_case(far, near, scene.plate(_truth_file(far)), ""), encoding="utf-8")
    return [ddic_command(), "run", str(path)]


def _listed(values: Sequence[int]) -> str:
    return ", ".join(map(str, values))

"""Fig. 4 of [BP17]: far and near fields as measured, less alpha0, continuous (Eq. 21), regularized (Eq. 23).

Meshes with their displacement times 30, on the synthetic plate with a hole of the near-far example, seen by a far and a
near camera whose set-up has moved.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.papers.compared import UNKNOWN, Compared
from bench.support.drawn_meshes import MovedMesh
from bench.support.near_far_case import (
    AROUND,
    Exact,
    Fields,
    Pair,
    Scene,
    continuous,
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
from bench.support.runs import ddic_run
from ddic.io.result_reader import Result, read_result
from ddic.plots.canvas import find_mesh_bounds, set_bounds

PLACE = "[BP17, section 4, Fig. 4]"

N_RANKS, N_SUBDOMAINS = 2, 6
WAVELENGTH, NOISE = 96, 2.0
FACTOR = 30.0
"""Amplification of the displacement, the paper's."""

SPLINE = "[correlation]\nspline_degree = 5\n"
GAP = f'[regularization]\ncut_off_wavelength = {WAVELENGTH}\nnot_controlled = ["left", "right", "top", "bottom"]\n'
SOLVER = f'[solver]\nmethod = "dual"\nsubdomains = {N_SUBDOMAINS}\n'

RAW, LESS, EQ_21, EQ_23 = "as measured", "less alpha0, Eq. 22", "continuous, Eq. 21", "regularized, Eq. 23"
SHOWN = {RAW: "panel of the fields as measured", LESS: "panel of the fields less alpha0",
         EQ_21: "panel of Eq. 21", EQ_23: "panel of Eq. 23"}
"""What the paper's figure has."""

JUMP_BOUND = 1e-3
"""Pixels, of fields that are coupled; far below the jumps of those that are not."""


def measure(folder: Path, *, smoke: bool) -> list[Compared]:
    """Measure the four fields and draw them."""
    if smoke:
        scene = Scene(480, 400, 3.0, (1.7, -1.2), 8.0, folder)
    else:
        scene = Scene(1392, 1040, 5.0, (3.7, -2.2), 8.0, folder)
    far, near, truth = render_scene(scene, NOISE)
    cases = {EQ_21: SOLVER, EQ_23: f'{SOLVER}weighting = "paper"\n{GAP}'}
    jumps, results = {}, {}
    for number, (name, rest) in enumerate(cases.items()):
        case = joint_case(far, near, scene.plate(far.reference.parent / "truth.json"), f"{SPLINE}{rest}")
        summary = ddic_run(case, folder, N_RANKS, f"joint_{number}")
        jumps[name], results[name] = summary["largest_jump_px"], read_result(folder / f"joint_{number}.vtkhdf")
    fields = {**_measure_alone(results[EQ_21], (far, near), folder),
              **{name: continuous(result) for name, result in results.items()}}
    jumps |= {name: largest_jump(fields[name]) for name in (RAW, LESS)}
    _draw(fields).savefig(folder / "bp17_near_far_fig4.png", dpi=150)
    setting = (f"plate with a hole, two images of {scene.width} x {scene.height} px, ratio {scene.ratio:g}, near "
               f"set-up moved by {scene.alpha} far px, 8 bit, noise of {NOISE:g} grey levels, Q4 of "
               f"{scene.element_size:g} far px, quintic spline; Eq. 23 with l_c = {WAVELENGTH} px and the "
               "paper's weights of interface rows")
    return [row for name in SHOWN for row in _list_rows(name, setting, fields[name], jumps[name],
                                                        truth.displacement, scene)]


def _measure_alone(joint: Result, pairs: tuple[Pair, Pair], folder: Path) -> dict[str, Fields]:
    """Fields of each camera's images by themselves on the elements of a joint result, with alpha and without."""
    alone = [measured_alone(joint, k, pair, folder, f'{SPLINE}[solver]\nmethod = "monolithic"\n')
             for k, pair in enumerate(pairs)]
    less = independent(joint, alone)
    raw = replace(less, u=[camera.seen for camera in alone], alpha=np.zeros(2))
    return {RAW: raw, LESS: less}


def _list_rows(name: str, setting: str, fields: Fields, jump: float, exact: Exact, scene: Scene) -> list[Compared]:
    far, near = (rms(e) for e in errors(fields, exact))
    is_coupled = name in (EQ_21, EQ_23)
    why = "before copies of a node are averaged, over all subdomains" if is_coupled else ""
    found = [Compared(PLACE, f"{name}: largest jump between the fields", setting, SHOWN[name], f"{jump:.1e} px", why,
                      f"at most {JUMP_BOUND:g} px" if is_coupled else "", not is_coupled or jump <= JUMP_BOUND,
                      judged_small=is_coupled),
             Compared(PLACE, f"{name}: RMS error per component", setting, UNKNOWN,
                      f"{error_rms(fields, exact):.4f} px (far {far:.4f}, near {near:.4f}); at the nodes of both "
                      f"{interface_error(fields, exact):.4f}, oscillation there {oscillation(fields, exact):.4f}",
                      "far px; alpha counts as an error of the near field" if name == RAW else "far px")]
    if name != RAW:
        off = np.abs(fields.alpha - scene.alpha)
        sign = "ours moves what the near camera sees; the paper's, in u_n - u_f + alpha = 0, has the other sign"
        found.append(Compared(PLACE, f"{name}: alpha", setting, UNKNOWN,
                              f"({fields.alpha[0]:.4f}, {fields.alpha[1]:.4f}) far px, off by ({off[0]:.4f}, "
                              f"{off[1]:.4f})", sign))
    return found


def _draw(fields: Mapping[str, Fields]) -> Figure:
    """Four panels of the meshes of both fields around the near one."""
    figure = Figure(figsize=(10, 9), layout="constrained")
    for axes, letter, (name, field) in zip(figure.subplots(2, 2).flat, "abcd", fields.items(), strict=True):
        _draw_panel(axes, field)
        axes.set_title(f"({letter}) {name}")
    figure.suptitle(f"far field (blue) and near field (red), displacement x {FACTOR:g}")
    return figure


def _draw_panel(axes: Axes, field: Fields) -> None:
    parts = [field.mesh.create_submesh(np.flatnonzero(field.cells == camera))[0] for camera in range(2)]
    for mesh, u, colour in zip(parts, field.u, ("tab:blue", "tab:red"), strict=True):
        MovedMesh(mesh, u).draw(axes, FACTOR, facecolor="none", edgecolor=colour, linewidth=0.5)
    set_bounds(axes, find_mesh_bounds(parts[1].nodes, AROUND))
    axes.set(xlabel="x [far px]", ylabel="y [far px]", aspect="equal")

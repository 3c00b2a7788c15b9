"""Bent, torn, masked and random fields, pairs that cannot be measured, and frames that start from a given field."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import ddic
from accept.support.deformed_pair import (
    Camera,
    Deformation,
    Measured,
    Pair,
    make_linear,
    make_rotation,
    measure_deformed,
    render_deformed,
)
from accept.table import Scale
from bench.support.opened_pair import picture
from bench.support.rows import Row, append_result
from ddic.mesh.cell_type import Q4
from ddic.mesh.mesh import build_mesh
from ddic.synth.speckle import SpeckleTexture

Array = NDArray[np.float64]

RIGHT_PX = 0.3
"""Largest error of a node, pixels, of a field that counts as right."""

N_RANDOM, FEWEST_RIGHT = 300, 299
RANDOM_SIDE, RANDOM_REGION, RANDOM_ELEMENT = 900, 180, 16
"""Sides of the images, of the region in their middle, and of the elements, those of the documentation; pixels."""
LARGEST_DISPLACEMENT, LARGEST_GRADIENT = 0.4, 0.15
GRADIENT_STEP = 6
"""Distance of the points of the region at which gradients are taken, pixels: a fiftieth of the shortest wave."""
TORN = 60.0


def measure_shapes(scale: Scale) -> list[Row]:
    """Measure a bent strip, a torn one, a plate with a hole and a masked one."""
    rows = [_judge("a torn strip whose halves part by 60 px, a mesh of two pieces", *_tear())]
    if scale.smoke:
        return rows
    bent = _bend(np.deg2rad(40.0))
    strip = ddic.structured_mesh((100, 130, 900, 270), 14)
    rows.append(_judge("bending to 40 degrees between the ends", strip, bent, measure_deformed(
        render_deformed(bent, Camera((1000, 500))), strip, bent)))
    turned = make_linear(make_rotation(8.0, 1.02), np.full(2, 300.0), np.array([14.3, -7.2]))
    pair = render_deformed(turned, Camera((600, 600)))
    with_hole = ddic.structured_mesh((150, 150, 450, 450), 15, circles=[((300.0, 300.0), 60.0)])
    rows.append(_judge("a hole, a rotation of 8 degrees", with_hole, turned, measure_deformed(pair, with_hole, turned)))
    rows.append(_measure_masked(pair, turned))
    return rows


def _judge(what: str, mesh: ddic.Mesh, deformation: Deformation, found: Measured) -> Row:
    largest = np.abs(deformation.displacement(mesh.nodes)).max()
    told = (f"{found.n_iterations} iterations, RMS error {found.rms:.4f} px, largest {found.largest:.3f} px"
            if found.converged else f"not converged: {found.refusal}")
    return Row(f"{what} (displacements to {largest:.0f} px)", f"converges, no node off by more than {RIGHT_PX} px",
               told, found.converged and found.largest <= RIGHT_PX)


def _bend(angle: float) -> Deformation:
    """A strip of 800 px becomes an arc."""
    radius = 800 / angle

    def displacement(points: Array) -> Array:
        theta, r = (points[:, 0] - 500) / radius, radius + 200 - points[:, 1]
        x, y = 500 + r * np.sin(theta), 200 + radius - r * np.cos(theta)
        return np.asarray(np.stack([x, y], axis=1) - points)

    return Deformation(displacement)


def _tear() -> tuple[ddic.Mesh, Deformation, Measured]:
    """Two halves, each with its own strain; what opens between them is dark."""
    upper, lower = ddic.structured_mesh((60, 60, 200, 260), 20), ddic.structured_mesh((60, 280, 200, 480), 20)
    mesh = build_mesh(np.vstack([upper.nodes, lower.nodes]),
                      {Q4: np.vstack([upper.cells[:, :4], lower.cells[:, :4] + upper.n_nodes])})
    width, height, edge = 260, 620, 270.0

    def displacement(points: Array) -> Array:
        is_lower = points[:, 1] > edge
        return np.stack([np.where(is_lower, 2.0, 0.0), np.where(is_lower, TORN, 0.0) + 0.002 * points[:, 1]], axis=1)

    texture, random = SpeckleTexture(3), np.random.default_rng(0)
    y, x = np.mgrid[0:height, 0:width].astype(float)
    pixels = np.column_stack([x.ravel(), y.ravel()])
    of_upper, of_lower = pixels / [1.0, 1.002], (pixels - [2.0, TORN]) / [1.0, 1.002]
    shows_lower, shows_upper = of_lower[:, 1] > edge, of_upper[:, 1] < edge
    origins = np.where(shows_lower[:, None], of_lower, of_upper)
    reference, deformed = (picture(texture, points, 8, 2.0 * random.standard_normal(len(points)))
                           for points in (pixels, origins))
    deformed[~shows_lower & ~shows_upper] = 30
    pair = reference.reshape(height, width), deformed.reshape(height, width)
    deformation = Deformation(displacement)
    return mesh, deformation, measure_deformed(pair, mesh, deformation)


def _measure_masked(pair: Pair, deformation: Deformation) -> Row:
    """A fifth of the region masked, through a case file."""
    mask = np.full(pair[0].shape, 255, np.uint8)
    mask[150:450, 230:290] = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for image, file in ((pair[0], "f.tif"), (pair[1], "g.tif"), (mask, "mask.tif")):
            cv2.imwrite(str(folder / file), image)
        (folder / "case.toml").write_text(
            '[images]\nreference = "f.tif"\ndeformed = "g.tif"\nreference_mask = "mask.tif"\n'
            "[mesh.structured]\nregion = [150, 150, 450, 450]\nelement_size = 15\n"
            "[regularization]\ncut_off_wavelength = 60\n", encoding="utf-8")
        try:
            result = ddic.measure(folder / "case.toml")
        except ddic.DdicError as error:
            return Row("20 % of the region masked", "converges", str(error).splitlines()[0], False)
    nodes = result.mesh.nodes
    is_seen = (nodes[:, 0] < 229) | (nodes[:, 0] > 291)
    off = np.linalg.norm(result.displacement - deformation.displacement(nodes), axis=1)[is_seen]
    return Row("20 % of the region masked, a rotation of 8 degrees, l_c = 60 px",
               f"converges, no node outside the mask off by more than {RIGHT_PX} px",
               f"largest error outside the mask {off.max():.3f} px", bool(off.max() <= RIGHT_PX))


def measure_random(scale: Scale) -> list[Row]:
    """Measure random smooth fields, images and noise."""
    n_fields = 2 if scale.smoke else N_RANDOM
    n_right, wrong, refused = 0, [], []
    low, high = (RANDOM_SIDE - RANDOM_REGION) / 2, (RANDOM_SIDE + RANDOM_REGION) / 2
    mesh = ddic.structured_mesh((low, low, high, high), RANDOM_ELEMENT)
    gradients = LARGEST_GRADIENT * np.arange(1, n_fields + 1) / n_fields
    for seed, gradient in enumerate(gradients):
        random = np.random.default_rng(seed)
        deformation = make_random(random, float(gradient))
        camera = Camera((RANDOM_SIDE, RANDOM_SIDE), noise=random.uniform(0, 4), bits=int(random.choice([8, 16])),
                        speckle=random.uniform(3, 8) / 4.8, seed=seed)
        found = measure_deformed(render_deformed(deformation, camera), mesh, deformation)
        append_result("start_runs", {"case": f"random {seed}", "rms": found.rms, "largest": found.largest,
                                     "refusal": found.refusal})
        if not found.converged:
            refused.append(seed)
        elif found.largest > RIGHT_PX:
            wrong.append(f"{seed} ({found.largest:.2f} px)")
        else:
            n_right += 1
    told = f"{n_right} right; not converged: {refused or 'none'}; wrong: {', '.join(wrong) or 'none'}"
    return [Row(f"{n_fields} random smooth fields: displacement to {LARGEST_DISPLACEMENT:.0%} of the image, largest "
                f"gradient {gradients[0]:.3%} to {gradients[-1]:.0%} in equal steps, 8 and 16 bit, noise of 0 to 4 "
                f"grey levels, speckle of 3 to 8 px, {RANDOM_ELEMENT}-px elements",
                f"{FEWEST_RIGHT} of {N_RANDOM} right; none converged with a node off by more than {RIGHT_PX} px", told,
                n_right >= FEWEST_RIGHT * n_fields / N_RANDOM and not wrong)]


def make_random(random: np.random.Generator, largest: float) -> Deformation:
    """Make a translation, a gradient and three waves; rotations are among the gradients."""
    angle, share = random.uniform(0, 2 * np.pi), random.uniform()
    translation = share * LARGEST_DISPLACEMENT * RANDOM_SIDE * np.array([np.cos(angle), np.sin(angle)])
    # Room for the region's own displacement, so that it stays in the image.
    translation *= 1 - 0.15 * RANDOM_REGION / (LARGEST_DISPLACEMENT * RANDOM_SIDE)
    gradient = random.uniform(-1, 1, (2, 2))
    waves = [(random.uniform(-1, 1, 2), random.uniform(-1, 1, 2), random.uniform(0, 2 * np.pi)) for _ in range(3)]
    centre = np.full(2, RANDOM_SIDE / 2)
    # Waves of 300 px and longer.
    number = 2 * np.pi / 300

    def shape(points: Array) -> Array:
        u = (points - centre) @ gradient.T
        for direction, k, phase in waves:
            u = u + np.sin(number * (points - centre) @ k + phase)[:, None] * direction / number
        return np.asarray(u)

    factor = largest / measure_largest_gradient(Deformation(shape))
    return Deformation(lambda points: translation + factor * shape(points))


def measure_largest_gradient(deformation: Deformation) -> float:
    """Largest spectral norm of du_i/dx_j in the region of random fields."""
    along = (RANDOM_SIDE - RANDOM_REGION) / 2 + np.arange(0.0, RANDOM_REGION + 1, GRADIENT_STEP)
    points = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    return float(np.linalg.norm(deformation.gradient(points), 2, axis=(1, 2)).max())


def measure_small_elements(scale: Scale) -> list[Row]:
    """Measure with elements of 2 and 3 px, regularized."""
    turned = make_linear(make_rotation(4.0, 1.01), np.full(2, 200.0), np.array([5.3, -7.2]))
    pair = render_deformed(turned, Camera((400, 400)))
    side = 60 if scale.smoke else 180
    rows = []
    for element in (2, 3):
        mesh = ddic.structured_mesh((200 - side / 2, 200 - side / 2, 200 + side / 2, 200 + side / 2), element)
        found = measure_deformed(pair, mesh, turned, {"regularization": {"cut_off_wavelength": 40}})
        rows.append(_judge(f"elements of {element} px, l_c = 40 px, a rotation of 4 degrees", mesh, turned, found))
    return rows


def measure_refused(scale: Scale) -> list[Row]:
    """Measure pairs that have no field, or several."""
    turned = make_linear(make_rotation(3.0), np.full(2, 250.0), np.array([5.3, -7.2]))
    reference, deformed = render_deformed(turned, Camera((500, 500)))
    mesh = ddic.structured_mesh((150, 150, 350, 350), 20)
    unrelated = render_deformed(turned, Camera((500, 500), seed=77))[1]
    rows = [_judge_refusal("unrelated images", (reference, unrelated), mesh, None)]
    if scale.smoke:
        return rows
    rows.append(_judge_refusal("a mirrored image", (reference, deformed[:, ::-1].copy()), mesh, None))
    rows.append(_judge_refusal("grey levels inverted", (reference, 255 - deformed), mesh, turned))
    y, x = np.mgrid[0:500, 0:500]
    pattern = np.rint(127 + 100 * np.sin(2 * np.pi * x / 12) * np.sin(2 * np.pi * y / 12)).astype(np.uint8)
    shifted = make_linear(np.zeros((2, 2)), np.zeros(2), np.array([17.0, 0.0]))
    rows.append(_judge_refusal("a repetitive texture, shifted by more than its period",
                               (pattern, np.roll(pattern, 17, axis=1)), mesh, shifted))
    return rows


def _judge_refusal(what: str, pair: Pair, mesh: ddic.Mesh, truth: Deformation | None) -> Row:
    anything = make_linear(np.zeros((2, 2)), np.zeros(2))
    found = measure_deformed(pair, mesh, truth or anything)
    is_right = truth is not None and found.converged and found.largest <= RIGHT_PX
    told = f"refused: {found.refusal}" if not found.converged else f"converged, largest error {found.largest:.2f} px"
    return Row(what, "the right field, or refused with the reason", told, is_right or not found.converged)


SIDE, REGION, ELEMENT = 900, 260, 20
"""Sides of the images, of the region in their middle, and of the elements, pixels."""

OF_NOTHING = 1.1
"""Largest RMS error, times that of a start from nothing."""

SAME_PX = 1e-3
"""Largest difference, pixels, between a frame and the same frame restarted from its own result: Gauss-Newton's."""

WRONG_PX, N_POINTS = 1.5, 200
"""How wrong points of a table are, standard deviation in pixels, and how many."""

PERIOD, REPEATED_SHIFT = 12, 41.0
"""Of a repetitive texture, and how far it is shifted, pixels."""


def measure_initial_fields(scale: Scale) -> list[Row]:
    """Measure later frames of a series from given displacements."""
    mesh, first = _mesh_in_the_middle(REGION), _deform(0.0, np.zeros(2), 0.01)
    pair = render_deformed(first, Camera((SIDE, SIDE)))
    earlier = ddic.measure(pair, mesh)
    of_part = ddic.measure(pair, _mesh_in_the_middle(REGION / 2))
    later = {
        "a jump of 40 px": _deform(0.0, np.array([40.0, 0.0]), 0.014),
        "a jump of 180 px": _deform(0.0, np.array([-150.0, 100.0]), 0.014),
        "a jump of 40 px, 10 degrees and 5 % of strain": _deform(10.0, np.array([30.0, 27.0]), 0.06),
        "120 degrees": _deform(120.0, np.array([5.0, 9.0]), 0.014),
    }
    rows = []
    for name, deformation in list(later.items())[:1] if scale.smoke else later.items():
        rows.append(_compare(name, deformation, earlier, of_part))
    return rows if scale.smoke else [*rows, _restart(pair, mesh, earlier), _measure_repeated()]


def _mesh_in_the_middle(region: float) -> ddic.Mesh:
    low, high = (SIDE - region) / 2, (SIDE + region) / 2
    return ddic.structured_mesh((low, low, high, high), ELEMENT)


def _deform(degrees: float, translation: Array, strain: float) -> Deformation:
    """A rotation and a translation after strain and a wave of 300 px."""
    centre, turned = np.full(2, SIDE / 2), make_rotation(degrees) + np.eye(2)

    def displacement(points: Array) -> Array:
        offsets = points - centre
        wave = 300 / (2 * np.pi) * strain * np.sin(2 * np.pi * offsets / 300)
        stretched = offsets * [1 + strain, 1 - 0.3 * strain] + wave[:, ::-1] * [0.5, 0.2]
        return np.asarray(stretched @ turned.T + translation - offsets)

    return Deformation(displacement)


def _compare(name: str, deformation: Deformation, earlier: ddic.Result, of_part: ddic.Result) -> Row:
    """One later frame from everything that can be given."""
    mesh, pair = earlier.mesh, render_deformed(deformation, Camera((SIDE, SIDE)))
    nothing = measure_deformed(pair, mesh, deformation)
    found = {"the earlier result": measure_deformed(pair, mesh, deformation, start=earlier),
             "a result on a quarter of the region": measure_deformed(pair, mesh, deformation, start=of_part),
             f"{N_POINTS} points of a table, wrong by {WRONG_PX} px": _start_from_table(pair, mesh, deformation),
             "3 pairs in whole pixels": _start_from_pairs(pair, mesh, deformation)}
    for what, measured in found.items():
        append_result("start_runs", {"case": f"{name} from {what}", "rms": measured.rms, "nothing": nothing.rms,
                                     "refusal": measured.refusal})
    told = "; ".join(f"{what}: {_describe(measured)}" for what, measured in found.items())
    holds = nothing.converged and all(measured.converged and measured.rms <= OF_NOTHING * nothing.rms
                                      for measured in found.values())
    return Row(f"{name} since the earlier result", f"RMS error at most {OF_NOTHING} times that from nothing",
               f"from nothing {_describe(nothing)}; from {told}", holds)


def _describe(measured: Measured) -> str:
    return f"{measured.rms:.4f} px" if measured.converged else f"not converged ({measured.refusal[:60]})"


def _start_from_table(pair: Pair, mesh: ddic.Mesh, deformation: Deformation) -> Measured:
    random = np.random.default_rng(0)
    low, high = (SIDE - REGION) / 2, (SIDE + REGION) / 2
    points = random.uniform(low, high, (N_POINTS, 2))
    moved = deformation.displacement(points) + WRONG_PX * random.standard_normal(points.shape)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "points.csv"
        np.savetxt(path, np.hstack([points, moved]), delimiter=",", header="x,y,u,v", comments="")
        return measure_deformed(pair, mesh, deformation, _choose_start("from_points", path))


def _start_from_pairs(pair: Pair, mesh: ddic.Mesh, deformation: Deformation) -> Measured:
    middle, reach = SIDE / 2, 0.4 * REGION
    points = middle + reach * np.array([[-1.0, -0.9], [1.0, -0.8], [0.1, 1.0]])
    pairs = np.rint(np.hstack([points, points + deformation.displacement(points)]))
    return measure_deformed(pair, mesh, deformation, _choose_start("points", pairs))


def _choose_start(key: str, value: Any) -> dict[str, Any]:
    return {"start": {key: value}}


def _restart(pair: Pair, mesh: ddic.Mesh, earlier: ddic.Result) -> Row:
    again = ddic.measure(pair, mesh, start=earlier)
    off = float(np.abs(again.displacement - earlier.displacement).max())
    n_iterations = len(again.gauss_newton["iteration"])
    return Row("the frame itself, restarted from its own result",
               f"1 iteration, no node off by more than {SAME_PX:g} px", f"{n_iterations} iterations, {off:.1e} px",
               n_iterations == 1 and off <= SAME_PX)


def _measure_repeated() -> Row:
    """A texture that looks alike at every period: only one of the translations is right."""
    y, x = np.mgrid[0:500, 0:500]
    number = 2 * np.pi / PERIOD
    reference, deformed = (np.rint(127 + 100 * np.sin(number * (x - shift)) * np.sin(number * y)).astype(np.uint8)
                           for shift in (0.0, REPEATED_SHIFT))
    truth = make_linear(np.zeros((2, 2)), np.zeros(2), np.array([REPEATED_SHIFT, 0.0]))
    mesh = ddic.structured_mesh((150, 150, 350, 350), 20)
    nothing = measure_deformed((reference, deformed), mesh, truth)
    given = measure_deformed((reference, deformed), mesh, truth, _choose_start("points", [[250, 250, 292, 251]]))
    return Row(f"a texture of period {PERIOD} px shifted by {REPEATED_SHIFT:g} px, from one pair that is wrong by 1 px",
               "no node off by more than 0.1 px",
               f"largest error {given.largest:.3f} px; from nothing {nothing.largest:.1f} px",
               given.converged and given.largest <= 0.1)

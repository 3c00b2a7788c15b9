"""From the measured field to the material: simulations beside fields, parameters from images, laws, series as modes.

Images are rendered from fields that are known: Lekhnitskii's hole, finite elements that flow, two modes that vibrate or
grow. The open hole of the real data is measured as it is, and its parameters are printed.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import tifffile
from scipy.sparse.linalg import spsolve

from accept.source_rules import count_code
from accept.support.orthotropic_hole import OrthotropicHole
from accept.support.plastic_neck import draw_strip
from accept.table import Scale
from bench.support.before import checkout_before
from bench.support.rows import Row
from bench.support.runs import ROOT, ddic_command, environment, mpirun, real_data
from ddic.arrays import Array
from ddic.functionals.plasticity import PlasticLaw
from ddic.identification.laws import ElasticBody, ElasticLaw, LawOnCells
from ddic.io.result_reader import Result, read_result
from ddic.io.series_reader import read_series
from ddic.kinematics.strain import compute_displacement_gradients
from ddic.mesh.structured import build_structured_mesh
from ddic.methods.sweep import render_virtual_image
from ddic.synth.fields import Affine, DisplacementField, Hole, Sinusoidal
from ddic.synth.render import Digitiser, Picture, Scene, render_pair
from ddic.synth.speckle import SpeckleTexture

NOISE = 2.0
"""Grey levels of 8 bit."""


def _run(command: str, folder: Path, name: str, text: str, n_ranks: int = 1) -> Path:
    """Run a command of ddic on a case; where its result is."""
    path = folder / f"{name}.toml"
    path.write_text(f'{text}\n[output]\nfile = "{name}.vtkhdf"\n', encoding="utf-8")
    mpirun(n_ranks, ddic_command(), command, str(path))
    return folder / f"{name}.vtkhdf"


def _write_pair(folder: Path, field: DisplacementField, size: int, noise: float, seed: int = 0,
                hole: Hole | None = None, speckle: float = 1.0) -> None:
    """Render f.tif and g.tif, floats where there is no noise; ``speckle`` magnifies those of 3 to 4 px."""
    folder.mkdir(parents=True, exist_ok=True)
    pair = render_pair(Scene(SpeckleTexture(3, speckle), field, hole),
                       Picture(size, size, Digitiser(8 if noise else 32, noise, seed)))
    tifffile.imwrite(folder / "f.tif", pair.reference)
    tifffile.imwrite(folder / "g.tif", pair.deformed)


PAIR = '[images]\nreference = "f.tif"\ndeformed = "g.tif"\n'
QUINTIC = "[correlation]\nspline_degree = 5\n"


# ---------------------------------------------------------------------------------------------------- sensitivities

MOST_OFF = 1e-6
"""Relative."""


def measure_sensitivities(scale: Scale) -> list[Row]:
    """Differentiate the displacement of a body by its parameters, and take finite differences of its solutions."""
    del scale
    mesh = build_structured_mesh((0.0, 0.0, 96.0, 80.0), 8.0, circles=[((48.0, 40.0), 18.0)])
    outer = np.unique(np.concatenate([mesh.node_sets[side] for side in ("left", "right", "top", "bottom")]))
    inner = np.delete(np.arange(mesh.n_dofs).reshape(-1, 2), outer, axis=0).ravel()
    worst = {}
    for name, values in (("isotropic", [1.0, 0.3]), ("orthotropic", [5.0, 1.0, 0.28, 0.6, 30.0])):
        law, p = ElasticLaw(name), np.array(values)  # type: ignore[arg-type]
        body = ElasticBody(mesh, [LawOnCells(law, np.ones(mesh.n_cells, dtype=bool), p, np.ones(len(p), dtype=bool))])

        def solve(parameters: Array, body: ElasticBody = body) -> Array:
            u = np.zeros(mesh.n_dofs)
            u.reshape(-1, 2)[outer] = mesh.nodes[outer] * [-0.002, 0.01]
            stiffness = body.assemble_stiffness(parameters)
            u[inner] = spsolve(stiffness[inner][:, inner].tocsc(), -(stiffness @ u)[inner])
            return u

        u, stiffness = solve(p), body.assemble_stiffness(p)
        off = []
        for k, derivative in enumerate(body.differentiate_stiffness(p)):
            # S_k = -K_II^-1 (dK / dp_k u)_I
            found = spsolve(stiffness[inner][:, inner].tocsc(), -(derivative @ u)[inner])
            step = 1e-4 * p[k] * np.eye(len(p))[k]
            difference = (solve(p + step) - solve(p - step))[inner] / (2.0 * step[k])
            size = max(np.abs(difference).max(), np.abs(u).max() / p[k] * 1e-3)
            off.append(float(np.abs(found - difference).max() / size))
        worst[name] = max(off)
    return [Row("sensitivities of an open hole's displacement beside central differences, isotropic and orthotropic",
                f"<= {MOST_OFF:g} relative", ", ".join(f"{name} {value:.1e}" for name, value in worst.items()),
                max(worst.values()) <= MOST_OFF)]


# ---------------------------------------------------------------------------------------------------- the open hole

TRUE = {"young_1": 5.0, "poisson_ratio": 0.28, "shear": 0.6}
ANGLE, STRESS = 30.0, 0.02
"""Degrees; stress along y over E2."""

ALLOWED_EXACT = {"young_1": 0.002, "poisson_ratio": 0.002, "shear": 0.003}
ALLOWED_NOISY = {"young_1": 0.0045, "poisson_ratio": 0.0027, "shear": 0.0040}
"""Relative to E2, but for Poisson's ratio."""

LAWS = """
[identification]
loaded = ["left", "right", "top", "bottom"]
[[identification.material]]
law = "orthotropic"
young_1 = {young_1}
poisson_ratio = {poisson_ratio}
shear = {shear}
angle_degrees = 30
"""
FAR_OFF = LAWS.format(young_1=4.0, poisson_ratio=0.336, shear=0.48)
"""Starts at -20, +20 and -20 %."""

SEEDS = range(40)


def _write_hole(folder: Path, half: float, radius: float, noise: float, seed: int) -> None:
    """The pair of a plate with a hole; its image ends a radius beyond the square of side 2 half about the hole."""
    middle = half + 0.75 * radius
    field = OrthotropicHole((5.0, 1.0, 0.28, 0.6, ANGLE), (middle, middle), radius, (0.0, STRESS, 0.0), (0.3, -0.2))
    _write_pair(folder, field, round(2 * middle), noise, seed, Hole((middle, middle), radius))


def _write_rings(path: Path, half: float, radius: float, n_around: int, n_out: int, growth: float) -> None:
    """Quadrangles in rings from a hole to the square about it, which grow outwards; sets of the square's sides."""
    middle = half + 0.75 * radius
    turn = np.linspace(0, 2 * np.pi, n_around, endpoint=False) + np.pi / 4
    ray = np.column_stack([np.cos(turn), np.sin(turn)])
    out = (growth ** np.arange(n_out + 1) - 1) / (growth**n_out - 1)
    ends = ray * radius, ray / np.abs(ray).max(axis=1, keepdims=True) * half
    nodes = ((1 - out)[:, None, None] * ends[0] + out[:, None, None] * ends[1]).reshape(-1, 2)
    k = np.arange(n_around)
    ring = np.column_stack([k, k + n_around, (k + 1) % n_around + n_around, (k + 1) % n_around])
    cells = np.concatenate([ring + n_around * row for row in range(n_out)])
    sides = {"left": (0, -half), "right": (0, half), "top": (1, -half), "bottom": (1, half)}
    sets = {name: np.flatnonzero(np.abs(nodes[:, axis] - at) < 1e-6) for name, (axis, at) in sides.items()}
    points = np.column_stack([nodes + middle, np.zeros(len(nodes))])
    meshio.Mesh(points, [("quad", cells)], point_sets=sets).write(path, file_format="abaqus")


RINGS = '[mesh]\nfile = "rings.inp"\n'

LARGE, SMALL = (240.0, 80.0, 96, 16, 1.08), (90.0, 30.0, 48, 10, 1.08)
"""Plates in noise, and of smoke runs: half their side, radius of the hole, elements around it and out, growth."""


def _make_plate(folder: Path, plate: tuple[float, float, int, int, float], noise: float, seed: int = 0) -> None:
    _write_hole(folder, *plate[:2], noise, seed)
    _write_rings(folder / "rings.inp", *plate)


def _read_parameters(path: Path) -> dict[str, tuple[float, float, float]]:
    """Value, standard deviation and FEMU's value by parameter."""
    table = read_result(path).identified
    return {name.decode(): (float(value), float(deviation), float(by_fields)) for name, value, deviation, by_fields
            in zip(table["parameter"], table["value"], table["deviation"], table["by_fields"], strict=True)}


def _find_errors(found: Mapping[str, tuple[float, float, float]]) -> dict[str, float]:
    """Relative errors, but for Poisson's ratio."""
    return {name: (found[name][0] - true) / (1.0 if name == "poisson_ratio" else true) for name, true in TRUE.items()}


def _say(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.4f}" if name == "poisson_ratio" else f"{name} {value:.2%}"
                     for name, value in values.items())


def measure_hole(scale: Scale) -> list[Row]:
    """Identify the plate without noise, from 20 % off."""
    folder = scale.folder("identify_hole")
    plate = SMALL if scale.smoke else (480.0, 160.0, 320, 60, 1.017)
    _, radius, around, out, _ = plate
    _make_plate(folder, plate, 0.0)
    errors = _find_errors(_read_parameters(_run("identify", folder, "exact", PAIR + RINGS + QUINTIC + FAR_OFF)))
    return [Row(f"Lekhnitskii's hole of {radius:g} px, E1 / E2 = 5, fibres at 30 degrees, no noise, quintic, {around} "
                f"x {out} Q4 in rings: errors", _say(ALLOWED_EXACT), _say(errors),
                all(abs(errors[name]) <= most for name, most in ALLOWED_EXACT.items()), judged_small=False)]


def measure_hole_noise(scale: Scale) -> list[Row]:
    """Identify it in noise, pair by pair."""
    seeds, plate = (SEEDS[:2], SMALL) if scale.smoke else (SEEDS, LARGE)

    def identify(seed: int) -> dict[str, tuple[float, float, float]]:
        folder = scale.folder(f"identify_hole_{seed}")
        _make_plate(folder, plate, NOISE, seed)
        return _read_parameters(_run("identify", folder, "noisy", PAIR + RINGS + FAR_OFF))

    with ThreadPoolExecutor(scale.jobs) as pool:
        found = list(pool.map(identify, seeds))
    errors = {name: np.array([_find_errors(of)[name] for of in found]) for name in TRUE}
    scatter = {name: float(values.std(ddof=1)) for name, values in errors.items()}
    share = {name: float(np.std([of[name][0] for of in found], ddof=1) / np.mean([of[name][1] for of in found]))
             for name in TRUE}
    apart = max(abs(of[name][0] - of[name][2]) / of[name][1] for of in found for name in TRUE)
    what = f"the same of {plate[1]:g} px, {NOISE:g} grey levels, {len(seeds)} pairs"
    return [Row(f"{what}: standard deviations", _say(ALLOWED_NOISY), _say(scatter),
                all(scatter[name] <= most for name, most in ALLOWED_NOISY.items()), judged_small=False),
            Row(f"{what}: standard deviations, observed over predicted", "0.75 to 1.3",
                ", ".join(f"{name} {value:.2f}" for name, value in share.items()),
                all(0.75 <= value <= 1.3 for value in share.values()), judged_small=False),
            Row(f"{what}: integrated DIC and FEMU", "<= 0.05 standard deviations apart", f"{apart:.3f}", apart <= 0.05,
                judged_small=False)]


MOST_ITERATIONS = 6


def measure_iterations(scale: Scale) -> list[Row]:
    """Count the iterations of both from 20 % off, on the command's own log."""
    folder = scale.folder("identify_iterations")
    _make_plate(folder, SMALL if scale.smoke else LARGE, NOISE)
    result = read_result(_run("identify", folder, "iterations", PAIR + RINGS + FAR_OFF))
    counts = [int(result.attributes["identification"][name]) for name in ("iterations_of_fields", "iterations")]
    return [Row("iterations from -20, +20 and -20 %: FEMU, then integrated DIC", f"<= {MOST_ITERATIONS} each",
                ", ".join(map(str, counts)), max(counts) <= MOST_ITERATIONS)]


# ---------------------------------------------------------------------------------------------------- isotropy

E, NU, THICKNESS, PIXEL = 70_000.0, 0.33, 2.0, 0.05
"""MPa, no unit, mm, mm."""

ISOTROPIC_SIDE = 480.0
"""Of the plate, pixels."""


def measure_isotropic(scale: Scale) -> list[Row]:
    """Identify E and nu of a plate in tension from images and the force on it."""
    seeds = range(2 if scale.smoke else 20)
    side, strain = 0.4 * ISOTROPIC_SIDE if scale.smoke else ISOTROPIC_SIDE, 0.01
    size = round(side) + 60
    field = Affine(((-NU * strain, 0.0), (0.0, strain)), (0.4, 0.3), (size / 2, size / 2))
    force = E * strain * side * PIXEL * THICKNESS
    text = f"""pixel_size = {PIXEL}
length_unit = "mm"
[mesh.structured]
region = [30, 30, {30 + side}, {30 + side}]
element_size = 16
{QUINTIC}[identification]
loaded = ["top", "bottom"]
thickness = {THICKNESS}
[[identification.material]]
law = "isotropic"
young = {0.8 * E}
poisson_ratio = 0.28
[[identification.force]]
nodes = "top"
direction = [0, -1]
value = {force}
deviation = {0.0075 * force}
"""

    def identify(seed: int, noise: float) -> dict[str, tuple[float, float, float]]:
        folder = scale.folder(f"identify_plate_{seed}_{noise:g}")
        _write_pair(folder, field, size, noise, seed)
        # The force is measured, too.
        measured = force * (1.0 + 0.0075 * float(np.random.default_rng(seed).standard_normal()) * (noise > 0))
        of_pair = text.replace(f"value = {force}", f"value = {measured}")
        return _read_parameters(_run("identify", folder, "plate", PAIR + of_pair))

    exact = identify(0, 0.0)
    with ThreadPoolExecutor(scale.jobs) as pool:
        noisy = list(pool.map(lambda seed: identify(seed, NOISE), seeds))
    off = abs(exact["poisson_ratio"][0] - NU), abs(exact["young"][0] / E - 1)
    scatter = (float(np.std([of["poisson_ratio"][0] for of in noisy], ddof=1)),
               float(np.std([of["young"][0] for of in noisy], ddof=1) / E))
    what = f"isotropic plate of {side:g} px in tension of {strain:.0%}, force known, quintic"
    return [Row(f"{what}, no noise: errors of nu and E", "<= 5e-4, 0.1 %", f"{off[0]:.1e}, {off[1]:.3%}",
                off[0] <= 5e-4 and off[1] <= 1e-3),
            Row(f"{what}, {NOISE:g} grey levels and 0.75 % of the force, {len(seeds)} pairs: standard deviations of nu "
                "and E", "<= 5.5e-4, 0.75 %", f"{scatter[0]:.1e}, {scatter[1]:.2%}",
                scatter[0] <= 5.5e-4 and scatter[1] <= 7.5e-3, judged_small=False)]


# ---------------------------------------------------------------------------------------------------- levelling

WAVES = Sinusoidal()
LEVELLED_WAVELENGTH = 64

SPECKLES = {1.5: "5", 1.0: "3.4"}
"""Magnification of the speckles, and how wide these are, pixels. Of the smaller ones the spline of a picture that ends
shows 0.4 grey levels at its edge, which is told and not judged."""


def measure_levelled(scale: Scale) -> list[Row]:
    """Compare a field with the simulation that is the truth, and with what virtual images of it show."""
    return [row for speckle, width in list(SPECKLES.items())[:1 if scale.smoke else None]
            for row in _measure_levelled(scale, speckle, width)]


def _measure_levelled(scale: Scale, speckle: float, width: str) -> list[Row]:
    folder, size = scale.folder("identify_levelled"), 192 if scale.smoke else 512
    _write_pair(folder, WAVES, size, 0.0, speckle=speckle)
    low, high = 32, size - 32
    text = (f"{PAIR}[mesh.structured]\nregion = [{low}, {low}, {high}, {high}]\nelement_size = 16\n{QUINTIC}"
            f"[regularization]\ncut_off_wavelength = {LEVELLED_WAVELENGTH}\n"
            '[simulation]\nfile = "truth.vtu"\nfit = "nothing"\n')
    fine = build_structured_mesh((8.0, 8.0, size - 8.0, size - 8.0), 2.0)
    u = WAVES.displacement(fine.nodes)
    points, vectors = (np.column_stack([values, np.zeros(fine.n_nodes)]) for values in (fine.nodes, u))
    meshio.Mesh(points, [("quad", fine.cells)], {"U": vectors}).write(folder / "truth.vtu")
    rows = []
    for name, what in (("truth", "measured less levelled"), ("virtual", "levelled beside virtual images")):
        if name == "virtual":
            x, y = np.meshgrid(np.arange(float(size)), np.arange(float(size)))
            at_pixels = WAVES.displacement(np.column_stack([x.ravel(), y.ravel()])).reshape(size, size, 2)
            tifffile.imwrite(folder / "g.tif", render_virtual_image(tifffile.imread(folder / "f.tif"), at_pixels))
        result = read_result(_run("compare", folder, name, text))
        off = result.point_data["simulation_difference"][:, :2]
        strains = _find_strains(result, off)
        inner = np.all((result.mesh.nodes > low) & (result.mesh.nodes < high), axis=1)
        said = (f"{_rms(off):.1e} px, strains {_rms(strains):.1e}; inner nodes {_rms(off[inner]):.1e} px")
        bound = 3e-4 if name == "truth" else 1e-4
        holds = _rms(off) <= bound and (name == "virtual" or _rms(strains) <= 15e-6)
        rows.append(Row(f"{what}, {size} x {size} px, speckles of {width} px, no noise, 16-px Q4, quintic, "
                        f"l_c = {LEVELLED_WAVELENGTH} px: RMS",
                        "reported" if speckle == 1.0 else f"<= {bound:g} px" + (", 15e-6" if name == "truth" else ""),
                        said, holds or speckle == 1.0, judged_small=False))
    return rows


def _find_strains(result: Result, u: Array) -> Array:
    """Strains of cells of a displacement of the nodes, (n_cells, 3)."""
    gradients = compute_displacement_gradients(result.mesh, u.ravel())
    return np.stack([gradients[:, 0, 0], gradients[:, 1, 1], 0.5 * (gradients[:, 0, 1] + gradients[:, 1, 0])], axis=1)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


# ---------------------------------------------------------------------------------------------------- a wrong law

ISOTROPIC = """
[identification]
loaded = ["left", "right", "top", "bottom"]
[[identification.material]]
law = "isotropic"
"""


def measure_wrong_law(scale: Scale) -> list[Row]:
    """Hold an isotropic law, and the right one, against an orthotropic plate in noise."""
    folder = scale.folder("identify_wrong")
    _make_plate(folder, SMALL if scale.smoke else LARGE, NOISE)
    chi = {}
    for name, law in (("isotropic", ISOTROPIC), ("orthotropic", FAR_OFF)):
        result = read_result(_run("identify", folder, name, PAIR + RINGS + law))
        chi[name] = float(result.compared_regions["chi_squared"][0]), float(result.compared_regions["scatter"][0])
    (wrong, _), (right, scatter) = chi["isotropic"], chi["orthotropic"]
    return [Row(f"chi^2 of laws on an orthotropic plate, {NOISE:g} grey levels",
                "isotropic beyond 1 by 5 of its scatter; orthotropic within 5 % of 1",
                f"isotropic {wrong:.2f}; orthotropic {right:.3f} (scatter {scatter:.3f})",
                wrong > 1 + 5 * scatter and abs(right - 1) <= 0.05, judged_small=False)]


# ---------------------------------------------------------------------------------------------------- formats, ranks

def measure_formats(scale: Scale) -> list[Row]:
    """Read every format by step, by time, and without a choice: the tests, which write the files, say how near."""
    del scale
    done = subprocess.run([sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider",
                           "tests/io/test_simulation_file.py"], cwd=ROOT, env=environment(), text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
    return [Row("PVD, XDMF, MED, Exodus, CSV, .frd, VTU of Abaqus: the field of a chosen step; a missing step is an "
                "error (tests/io/test_simulation_file.py)", "<= 1e-6 relative; an error", done.stdout.splitlines()[-1],
                done.returncode == 0)]


def measure_ranks(scale: Scale) -> list[Row]:
    """Identify on several ranks."""
    folder = scale.folder("identify_ranks")
    _make_plate(folder, SMALL, NOISE)
    text = (f'{PAIR}{RINGS}{FAR_OFF}[solver]\nmethod = "dual"\nsubdomains = 4\ntolerance = 1e-12\n'
            "[gauss_newton]\ntolerance = 1e-9\nrms_tolerance = 1e-7\nlargest_tolerance = 1e-6\n")
    ranks = (1, 2) if scale.smoke else (1, 2, 3, 4)
    values = [np.array([value for value, *_ in
                        _read_parameters(_run("identify", folder, f"on_{n}", text, n)).values()]) for n in ranks]
    off = max(float(np.abs(of / values[0] - 1).max()) for of in values)
    return [Row(f"parameters on {', '.join(map(str, ranks))} ranks, 4 subdomains", "<= 1e-9 relative", f"{off:.1e}",
                off <= 1e-9)]


# ---------------------------------------------------------------------------------------------------- laws, modes

@dataclass(frozen=True)
class TwoModes(DisplacementField):
    """Waves and a stretch with waves.

    Attributes
    ----------
    amplitudes : (float, float)
        Of both, pixels.
    """

    amplitudes: tuple[float, float]

    def displacement(self, points: Array) -> Array:
        """Displacement at points, (n, 2)."""
        (x, y), (a, b) = points.T, self.amplitudes
        return np.stack([a * np.sin(x / 60) * np.cos(y / 80) + 0.01 * b * (x - 80),
                         0.6 * a * np.cos(x / 70) - 0.003 * b * (y - 80) + 0.3 * b * np.sin(y / 50)], axis=-1)

    def gradient(self, points: Array) -> Array:
        """Its gradient, (n, 2, 2)."""
        (x, y), (a, b) = points.T, self.amplitudes
        of_u = [a / 60 * np.cos(x / 60) * np.cos(y / 80) + 0.01 * b, -a / 80 * np.sin(x / 60) * np.sin(y / 80)]
        of_v = [-0.6 * a / 70 * np.sin(x / 70), -0.003 * b + 0.3 * b / 50 * np.cos(y / 50)]
        return np.stack([np.stack(of_u, axis=-1), np.stack(of_v, axis=-1)], axis=-2)


def _write_series(folder: Path, fields: Sequence[DisplacementField], size: tuple[int, int], noise: float) -> None:
    """Render f.tif and g000.tif ..., each with noise of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, field in enumerate(fields):
        pair = render_pair(Scene(SpeckleTexture(3), field), Picture(*size, Digitiser(8, noise, k)))
        tifffile.imwrite(folder / f"g{k:03d}.tif", pair.deformed)
        if k == 0:
            tifffile.imwrite(folder / "f.tif", pair.reference)


SERIES = '[images]\nreference = "f.tif"\ndeformed = "g*.tif"\n'


def _measure_series_errors(path: Path, fields: Sequence[DisplacementField]) -> Array:
    """Errors of all frames, a component at a node, pixels; one after the other."""
    return np.concatenate([(frame.displacement - field.displacement(frame.mesh.nodes)).ravel()
                           for frame, field in zip(read_series(path), fields, strict=True)])


def measure_neck(scale: Scale) -> list[Row]:
    """Measure a strip that necks, with the law that it follows and with elasticity."""
    folder, n_frames = scale.folder("identify_neck"), 4 if scale.smoke else 20
    law = PlasticLaw(0.3, 0.002, 0.02)
    elongations = np.linspace(0.3, 6.0, 20)[:n_frames]
    fields = draw_strip(law, (0.0, 0.0, 400.0, 200.0), 50.0, elongations)
    _write_series(folder, fields, (401, 201), NOISE)
    text = (f"{SERIES}[mesh.structured]\nregion = [16, 16, 384, 184]\nelement_size = 8\n"
            "circles = [{ center = [200, 0], radius = 50 }, { center = [200, 200], radius = 50 }]\n"
            "[regularization]\ncut_off_wavelength = 128\n")
    errors = {}
    for name, keys in (("elastic", ""), ("plastic", "yield_strain = 0.002\nhardening_ratio = 0.02\n")):
        errors[name] = _rms(_measure_series_errors(_run("run", folder, name, text + keys), fields))
    share = errors["plastic"] / errors["elastic"]
    return [Row(f"a strip that necks, {n_frames} frames, {NOISE:g} grey levels, 8-px Q4, l_c = 128 px: RMS error with "
                "the plastic law over that with elasticity", "<= 0.5",
                f"{share:.2f} ({errors['plastic']:.4f} beside {errors['elastic']:.4f} px)", share <= 0.5,
                judged_small=False)]


MOVEMENTS: Mapping[str, tuple[Any, Any]] = {
    "vibration": (lambda t: 0.5 * np.sin(10 * np.pi * t), lambda t: 0.3 * np.sin(18 * np.pi * t + 0.4)),
    "loading": (lambda t: 0.8 * t, lambda t: 0.6 * t**2),
}
"""Amplitudes of both modes by time, pixels, from 0 to 1."""


def measure_modes(scale: Scale) -> list[Row]:
    """Measure 100 frames of two modes together and one by one."""
    rows, n_frames = [], 12 if scale.smoke else 100
    text = f"{SERIES}[mesh.structured]\nregion = [12, 12, 148, 148]\nelement_size = 8\n"
    for name, (first, second) in MOVEMENTS.items():
        folder = scale.folder(f"identify_{name}")
        times = np.arange(1, n_frames + 1) / n_frames
        fields = [TwoModes((float(a), float(b))) for a, b in zip(first(times), second(times), strict=True)]
        _write_series(folder, fields, (161, 161), NOISE)
        modes, single = (_run(command, folder, command, text) for command in ("modes", "run"))
        result = read_result(modes)
        together = np.concatenate([(result.compute_frame(k) - field.displacement(result.mesh.nodes)).ravel()
                                   for k, field in enumerate(fields, start=1)])
        rank = sum(key.startswith("amplitude_") for key in result.time_modes)
        share = _rms(together) / _rms(_measure_series_errors(single, fields))
        less = single.stat().st_size / modes.stat().st_size
        rows.append(Row(f"{name}, {n_frames} frames of two modes, {NOISE:g} grey levels, 8-px Q4: modes, RMS error "
                        "over that of single frames, size of the files", "2; <= 0.5; 10 times less",
                        f"{rank}; {share:.2f}; {less:.0f} times less", rank == 2 and share <= 0.5 and less >= 10,
                        judged_small=False))
    return rows


# ---------------------------------------------------------------------------------------------------- the real strip

def measure_openhole(scale: Scale) -> list[Row]:
    """Identify the real strip's ratios, and print them; nothing is known of them beforehand."""
    folder, data = scale.folder("identify_openhole"), real_data() / "openhole"
    folder.mkdir(parents=True, exist_ok=True)
    reference, deformed = (data / f"zoom-00{number}_1.tif" for number in (53, 66))
    path = _run("identify", folder, "openhole", f"""[images]
reference = "{reference}"
deformed = "{deformed}"
[mesh]
file = "{data / 'mesh_q4_pixels.msh'}"
[identification]
loaded = ["loaded_ends"]
[[identification.material]]
law = "orthotropic"
angle_degrees = 90
""")
    said = ", ".join(f"{name} = {value:.3g} +- {deviation:.2g}"
                     for name, (value, deviation, _) in _read_parameters(path).items())
    chi = float(read_result(path).compared_regions["chi_squared"][0])
    is_known = all(np.isfinite(deviation) for _, deviation, _ in _read_parameters(path).values())
    return [Row(f"real open hole, {reference.stem} to {deformed.stem}, axis 1 along the strip, E2 = 1", "printed, with "
                "standard deviations, residual map", f"{said}; chi^2 {chi:.1f}",
                is_known and (folder / "openhole.residual.vtkhdf").is_file())]


# ---------------------------------------------------------------------------------------------------- source

MOST_MORE, BEFORE = 2500, "4e564260"
"""Lines of code; the last commit without simulations and identification."""


def measure_source(scale: Scale) -> list[Row]:
    """Count what this table's work added to the source."""
    del scale
    more = count_code(ROOT / "src") - count_code(checkout_before(BEFORE) / "src")
    return [Row("lines of code in src/ more than before simulations and identification", f"at most {MOST_MORE}",
                str(more), more <= MOST_MORE)]

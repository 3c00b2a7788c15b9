"""The examples of [PP12]: gradient noise on a plate clamped on one side, corrections to convergence, errors by size.

And the corrections that the field of an inclined crack takes, with and without the update step.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve

import ddic
from accept.support.opened_pair import Crack
from accept.table import Scale
from bench.support.rows import Row, append_result
from ddic.functionals.regularization import Material, assemble_stiffness
from ddic.images.rigid import GridField

Array = NDArray[np.float64]
Pair = tuple[NDArray[Any], NDArray[Any]]

SIZE, REGION, ELEMENT = 500, (98.0, 98.0, 402.0, 402.0), 16
"""Of the first example: side of the images, the region of 304 x 304 px, side of the elements; pixels."""

OCTAVES, PERSISTENCE = (24, 12, 6), 0.8
"""Cells of the texture's octaves, pixels, and the amplitude of each relative to the one before."""

CONTRAST, SPREAD = 100.0, 0.6
"""Grey levels about the mean, and argument of the hyperbolic tangent at one standard deviation."""

LARGEST_PX = 2.0
"""Largest displacement of the plate."""

ROUNDS = 100
"""Steps of the fixed point that finds where a pixel came from; the strain of the plate is below 0.05."""

CLOSE = 1e-11
"""Pixels: change of a place from step to step at which it is found; the two faces of a crack never are, inside it."""

KINDS = ("float", "16 bit", "8 bit", "8 bit, noise of 2")
"""How images are stored; noise in grey levels of 256."""


def evaluate_gradient_noise(points: Array, seed: int) -> Array:
    """Evaluate Perlin's gradient noise, quintic blending, at points (n, 2): (n,), no unit."""
    random, total = np.random.default_rng(seed), np.zeros(len(points))
    for octave, cell in enumerate(OCTAVES):
        n = 700 // cell + 6
        angles = random.uniform(0.0, 2.0 * np.pi, (n, n))
        gradients = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        # Displaced pixels may leave the image.
        at = (points + 60.0) / cell
        corner = np.floor(at).astype(int)
        inside = at - corner
        blend = inside**3 * (6 * inside**2 - 15 * inside + 10)
        values = []
        for dy in (0, 1):
            row = []
            for dx in (0, 1):
                of_corner = gradients[corner[:, 1] + dy, corner[:, 0] + dx]
                row.append((of_corner * (inside - (dx, dy))).sum(axis=1))
            values.append(row[0] + blend[:, 0] * (row[1] - row[0]))
        total += PERSISTENCE**octave * (values[0] + blend[:, 1] * (values[1] - values[0]))
    return total


@dataclass(frozen=True)
class Plate:
    """A finite element field of a plate clamped on its left side and pulled obliquely at its right one."""

    @cached_property
    def field(self) -> GridField:
        """Displacement at the nodes of the 16-px elements; constant beyond the region."""
        mesh = ddic.structured_mesh(REGION, ELEMENT)
        stiffness = assemble_stiffness(mesh, Material(0.3)).tocsc()
        x = mesh.nodes[:, 0]
        free = np.repeat(x > REGION[0] + 1e-6, 2)
        forces = np.zeros((mesh.n_nodes, 2))
        forces[x > REGION[2] - 1e-6] = (1.0, 0.6)
        u = np.zeros(mesh.n_dofs)
        u[free] = spsolve(stiffness[free][:, free], forces.ravel()[free])
        u *= LARGEST_PX / np.abs(u).max()
        order = np.lexsort((mesh.nodes[:, 0], mesh.nodes[:, 1]))
        n = round((REGION[2] - REGION[0]) / ELEMENT) + 1
        return GridField((REGION[0], REGION[1]), (ELEMENT, ELEMENT), u.reshape(-1, 2)[order].reshape(n, n, 2))

    def displacement(self, points: Array) -> Array:
        """Displacement at points (n, 2), pixels."""
        return self.field.at(points)


@dataclass(frozen=True)
class Uniform:
    """The same displacement everywhere.

    Attributes
    ----------
    shift : tuple of float
        u and v, pixels.
    """

    shift: tuple[float, float]

    def displacement(self, points: Array) -> Array:
        """Displacement at points (n, 2), pixels."""
        return np.broadcast_to(np.asarray(self.shift), points.shape)


def render(field: Plate | Uniform | Crack, kind: str, size: int = SIZE, seed: int = 0) -> Pair:
    """Draw both images of a displacement.

    Parameters
    ----------
    field : Plate, Uniform or Crack
        What moves how.
    kind : str
        One of KINDS.
    size : int
        Side of the images, pixels.
    seed : int
        Of the noise.

    Returns
    -------
    reference, deformed : (size, size) array
        Grey levels.
    """
    y, x = np.mgrid[0:size, 0:size].astype(float)
    points = np.column_stack([x.ravel(), y.ravel()])
    origins = points
    for _ in range(ROUNDS):
        before, origins = origins, points - field.displacement(origins)
        if np.abs(origins - before).max() < CLOSE:
            break
    level = SPREAD / evaluate_gradient_noise(points, 1).std()
    random = np.random.default_rng(seed)

    def draw(places: Array) -> NDArray[Any]:
        grey = 127.5 + CONTRAST * np.tanh(level * evaluate_gradient_noise(places, 1)).reshape(size, size)
        return store(grey, kind, random)

    return draw(points), draw(origins)


def store(grey: Array, kind: str, random: np.random.Generator) -> NDArray[Any]:
    """Store grey levels of 256 as one of KINDS."""
    if kind == "float":
        return np.asarray(grey, dtype=np.float32)
    if kind == "16 bit":
        return np.asarray(np.rint(257.0 * grey), dtype=np.uint16)
    noise = 2.0 if kind.endswith("of 2") else 0.0
    levels = np.clip(np.rint(grey + noise * random.standard_normal(grey.shape)), 0, 255)
    return np.asarray(levels, dtype=np.uint8)


def list_pixels(region: tuple[float, float, float, float] = REGION) -> Array:
    """Pixel centres of a region (n, 2)."""
    x, y = np.meshgrid(np.arange(region[0], region[2]), np.arange(region[1], region[3]))
    return np.column_stack([x.ravel(), y.ravel()])


def measure_rms(difference: Array, *, spread: bool = False) -> float:
    """RMS per component of differences (n, 2), or their standard deviation; pixels."""
    return float(np.sqrt(difference.var(axis=0).mean() if spread else (difference**2).mean()))


ETA = 1e-3
"""Of [PP12]: RMS of a correction relative to the displacement, of both components."""

MOST = {"float": 12, "16 bit": 12, "8 bit": 25}
"""Corrections to it, by the kind of images."""

PUBLISHED: dict[str, Any] = {"update": False, "stop_at_noise": False, "rms_tolerance": 0.0}
"""The algorithm as it is published."""

COMPLETE: dict[str, Any] = {"stop_at_noise": False, "rms_tolerance": 1e-6, "tolerance": 1e-5}
"""Far beyond the noise: the displacement of Q4 elements."""

SIZES, SMOKE_SIZES = (8, 16, 19, 38, 76), (16, 38)
"""Sides of elements that divide the region, pixels."""

SHIFTS, SMOKE_SHIFTS = (0.1, 0.3, 0.5, 0.7, 0.9), (0.3,)
"""Uniform displacements along both axes, pixels."""

SLOPES = {"error": -1.49, "uncertainty": -1.70}
"""The paper's, of log-log curves."""

LARGEST_OF_SLOPE = {"error": 19, "uncertainty": 76}
"""Elements up to which a slope is taken, pixels."""

WITHIN = 0.10



def measure_pgd(pair: Pair, element: float, pgd: dict[str, Any]) -> ddic.Result:
    """Measure the region of the example from a rigid translation.

    Parameters
    ----------
    pair : tuple of array
        The images.
    element : float
        Side of the elements, pixels.
    pgd : dict
        Keys of ``[pgd]``.

    Returns
    -------
    Result
        In memory.
    """
    return ddic.measure(pair, mesh={"structured": {"region": REGION, "element_size": element}}, pgd=pgd,
                        start={"pyramid": False})


def count_to_eta(result: ddic.Result) -> int | None:
    """Corrections after which the paper's eta is below ETA for both components; None where it never is."""
    eta = np.maximum(result.corrections["relative_x"], result.corrections["relative_y"])
    below = np.flatnonzero(eta < ETA)
    return int(below[0]) + 1 if len(below) else None


def measure_corrections(scale: Scale) -> list[Row]:
    """Count corrections on float, 16-bit, 8-bit and noisy images."""
    rows, points, plate = [], list_pixels(), Plate()
    known = plate.displacement(points)
    for kind in KINDS[:1] if scale.smoke else KINDS:
        pair = render(plate, kind)
        published, default = measure_pgd(pair, ELEMENT, PUBLISHED), measure_pgd(pair, ELEMENT, {})
        q4 = ddic.measure(pair, ddic.structured_mesh(REGION, ELEMENT), solver={"method": "assembled"})
        n, most = count_to_eta(published), MOST.get(kind)
        errors = {name: measure_rms(result.at(points) - known)
                  for name, result in (("published", published), ("default", default), ("Q4", q4))}
        n_default = len(default.corrections["correction"])
        append_result("pgd_runs", {"check": "corrections", "kind": kind, "n": n, "n_default": n_default, **errors})
        rows.append(Row(f"first example of [PP12], {kind}, 16-px elements, published algorithm: corrections to eta < "
                        f"{ETA:g} (default: update, stop at noise)",
                        f"at most {most}" if most else "reported beside 32-36 of a prototype",
                        f"{n} corrections, error {errors['published']:.5f} px (default: {n_default} corrections, "
                        f"{errors['default']:.5f} px; Q4-DIC {errors['Q4']:.5f} px)",
                        most is None or (n is not None and n <= most), judged_small=most is not None))
    return rows


def measure_sizes(scale: Scale) -> list[Row]:
    """Compare error and uncertainty with Q4-DIC's as functions of the elements' size."""
    sizes = SMOKE_SIZES if scale.smoke else SIZES
    pairs: dict[str, list[tuple[Pair, Plate | Uniform]]] = {
        "error": [(render(Plate(), "8 bit"), Plate())],
        "uncertainty": [(render(Uniform((shift, shift)), "8 bit, noise of 2", seed=k), Uniform((shift, shift)))
                        for k, shift in enumerate(SMOKE_SHIFTS if scale.smoke else SHIFTS)]}
    return [_compare(name, sizes, pairs[name]) for name in pairs]


def _compare(name: str, sizes: tuple[int, ...], pairs: list[tuple[Pair, Plate | Uniform]]) -> Row:
    points, of_pgd, of_q4 = list_pixels(), [], []
    for size in sizes:
        mesh = ddic.structured_mesh(REGION, size)
        found: list[tuple[float, float]] = []
        for pair, field in pairs:
            known = field.displacement(points)
            pgd = measure_pgd(pair, size, COMPLETE)
            q4 = ddic.measure(pair, mesh, solver={"method": "assembled"})
            found.append((measure_rms(pgd.at(points) - known, spread=name == "uncertainty"),
                          measure_rms(q4.at(points) - known, spread=name == "uncertainty")))
        of_pgd.append(np.mean([a for a, _ in found]))
        of_q4.append(np.mean([b for _, b in found]))
    ratios = np.array(of_pgd) / np.array(of_q4)
    # On larger elements the plate's error is that of the elements, not of the images.
    n = sum(size <= LARGEST_OF_SLOPE[name] for size in sizes)
    slopes = [float(np.polyfit(np.log(sizes[:n]), np.log(values[:n]), 1)[0]) if n > 1 else float("nan")
              for values in (of_pgd, of_q4)]
    append_result("pgd_runs", {"check": name, "sizes": list(sizes), "pgd": of_pgd, "q4": of_q4, "slopes": slopes})
    listed = "; ".join(f"{h} px: {a:.4f} beside {b:.4f} px" for h, a, b in zip(sizes, of_pgd, of_q4, strict=True))
    what = "8 bit, error of the plate" if name == "error" else "uniform displacements, noise of 2 grey levels, spread"
    return Row(f"first example of [PP12], {what} by element size, beside Q4-DIC's", f"within {WITHIN:.0%}",
               f"{listed}; slope up to {sizes[n - 1]} px {slopes[0]:.2f} (Q4-DIC {slopes[1]:.2f}; the paper's "
               f"{SLOPES[name]:.2f})",
               bool((np.abs(ratios - 1.0) <= WITHIN).all()))


CRACK_ELEMENT, SMOKE_CRACK_ELEMENT = 8, 16
"""Side of the elements, pixels."""

PAPER, PAPER_Q4 = 81, 25
"""Corrections of [PP12], and its iterations of Q4-DIC."""

RUNS: dict[str, dict[str, Any]] = {
    "published": {**PUBLISHED, "max_corrections": 400},
    "with update": {**PUBLISHED, "update": True},
    "default": {},
}


def measure_separated_crack(scale: Scale) -> list[Row]:
    """Measure an inclined crack in mode I, its line not known."""
    element = SMOKE_CRACK_ELEMENT if scale.smoke else CRACK_ELEMENT
    crack = Crack(tip=np.array([250.3, 250.7]))
    pair, points = render(crack, "float", SIZE), list_pixels()
    known = crack.displacement(points)
    found = {}
    for name, pgd in list(RUNS.items())[-1:] if scale.smoke else RUNS.items():
        result = measure_pgd(pair, element, pgd)
        error = measure_rms(result.at(points) - known)
        found[name] = (len(result.corrections["correction"]), count_to_eta(result), error)
    q4 = ddic.measure(pair, ddic.structured_mesh(REGION, element),
                      solver={"method": "assembled"}, start={"pyramid": False})
    n_q4, error_q4 = len(q4.gauss_newton["iteration"]), measure_rms(q4.at(points) - known)
    append_result("pgd_runs", {"check": "crack", **found, "q4": [n_q4, error_q4]})
    listed = "; ".join(f"{name}: {n} corrections ({eta} to eta < 1e-3), error {error:.4f} px"
                       for name, (n, eta, error) in found.items())
    return [Row(f"mode I crack at {np.rad2deg(crack.angle):.0f} degrees across the region, {element}-px elements, "
                "float images, from a rigid translation", f"converges; the paper needs {PAPER} corrections (Q4-DIC "
                f"{PAPER_Q4})", f"{listed}; Q4-DIC {n_q4} iterations, {error_q4:.4f} px", True)]

"""The tip of a straight crack with free faces, and its stress intensity factors: Williams' series fitted to a field."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import ConvergenceError, InputError
from ddic.fracture.opening import get_line
from ddic.functionals.grey_statistics import find_weighted_median
from ddic.io.result_reader import Result
from ddic.io.result_schema import CASE, NOISE_FLOOR, SIGMA_DISPLACEMENT, get_case
from ddic.mesh.interpolation import interpolate_located, place_in_cells
from ddic.mesh.quality import measure_areas


def find_kolosov_constant(poisson_ratio: float, plane: str | None) -> float:
    """Find Kolosov's constant kappa: (3 - nu) / (1 + nu) in plane "stress", 3 - 4 nu in plane "strain"."""
    return (3 - poisson_ratio) / (1 + poisson_ratio) if plane == "stress" else 3 - 4 * poisson_ratio


def evaluate_williams_series(points: Array, orders: IntArray, kappa: float) -> Array:
    """Evaluate the terms r^(n/2) of both modes, in the frame of the crack.

    Points, (n, 2), pixels, are from the tip, x ahead of the crack; faces are at x < 0, where the sign of y tells them
    apart. Of the orders n, 0 is a translation, 1 the singular strain, 2 the T-stress and a rotation; -1 is more
    singular than any crack, and tells that the tip lies elsewhere. Gives the displacement 2 mu u of a unit of each
    coefficient, (n, 2, 2 n_orders): first the opening mode of each order, then the sliding one.
    """
    r, theta = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
    half = orders / 2
    sign = (-1.0) ** np.abs(orders)
    power = r[:, None] ** half
    one, other = half * theta[:, None], (half - 2) * theta[:, None]
    opening_x = (kappa + half + sign) * np.cos(one) - half * np.cos(other)
    opening_y = (kappa - half - sign) * np.sin(one) + half * np.sin(other)
    sliding_x = -(kappa + half - sign) * np.sin(one) + half * np.sin(other)
    sliding_y = (kappa - half + sign) * np.cos(one) + half * np.cos(other)
    along_x = np.concatenate([power * opening_x, power * sliding_x], axis=1)
    along_y = np.concatenate([power * opening_y, power * sliding_y], axis=1)
    return np.stack([along_x, along_y], axis=1)


HIGHEST_ORDER = 7
"""n of the last term r^(n/2). Higher ones fit noise, lower ones miss what the specimen's edges do."""

INNER_CELLS = 3.0
"""Cells about the tip that do not count: shape functions do not hold the root of r, and the line ends at a cell's
side."""

OUTER_SHARE = 0.9
"""Share of the largest disk about the tip, within the mesh's box and the straight end of the line, that counts."""

LEAST_RATIO = 2.0
"""Outer radius over the inner one below which the terms are not told apart."""

FEWEST_CELLS = 40
"""Cells in the ring below which the series, of 18 coefficients, follows noise."""

SAME_TIP = 0.01
"""Pixels: a tip that moves by less has been found."""

MOST_MOVES = 50
"""Times that the tip is moved; three or four are usual."""

N_RINGS = 5
"""Rings over which a tip and its factors scatter. Their outer radii are in the same proportion from one to the next."""

LEAST_SPAN = 1.25
"""Largest outer radius over the smallest one below which rings are too much alike for a scatter."""

OF_ELEMENTS, OF_WAVES = 1 / 3, 0.4
"""Areas over which noise of a node's displacement is averaged, as far as fields of long waves see it: without a
regularization by the area of an element, with one by the square of a wavelength of which a half is left."""


@dataclass(frozen=True)
class TipDeviations:
    """Standard deviations of what is found of a crack's tip; nan where they are not known.

    Attributes
    ----------
    place : float
        Of the tip along the crack, pixels.
    opening_factor, sliding_factor, t_stress : float
        In the units of ``CrackTip``.
    """

    place: float
    opening_factor: float
    sliding_factor: float
    t_stress: float


UNKNOWN = TipDeviations(np.nan, np.nan, np.nan, np.nan)


@dataclass(frozen=True, eq=False)
class CrackTip:
    """A crack's tip; factors and stresses are in units of the shear modulus mu.

    Attributes
    ----------
    position : (2,) array
        Pixels.
    angle : float
        Of the crack ahead of the tip, radians from +x to +y.
    opening_factor, sliding_factor : float
        K_I / mu and K_II / mu, px^(1/2).
    t_stress : float
        T / mu, along the crack.
    inner, outer : float
        Radii of the ring of cells that were fitted, pixels.
    limit : str
        What the outer radius ends at, where it is not the one that was asked for.
    rms : float
        What the series leaves of the displacement, pixels.
    n_cells : int
        Cells in the ring.
    covered : float
        Share of the ring's area that they cover.
    scatter : TipDeviations
        Of the values over rings about the same tip, this one and smaller ones.
    n_rings : int
        How many rings found a tip, of N_RINGS; 1 where there was no room for smaller ones.
    noise : TipDeviations
        What the noise of the displacement alone makes of the values in this ring.
    """

    position: Array
    angle: float
    opening_factor: float
    sliding_factor: float
    t_stress: float
    inner: float
    outer: float
    limit: str
    rms: float
    n_cells: int
    covered: float
    scatter: TipDeviations
    n_rings: int
    noise: TipDeviations


@dataclass(frozen=True)
class Ring:
    """Radii of the ring about a tip in which the series is fitted.

    Attributes
    ----------
    inner, outer : float or None
        Pixels. By default three cells, and 0.9 times what the mesh's box and the straight end of the line leave.
    """

    inner: float | None = None
    outer: float | None = None


def find_crack_tip(result: Result, line: int = 1, *, tip: tuple[float, float] | None = None, poisson_ratio: float = 0.3,
                   plane: Literal["stress", "strain"] = "stress", ring: Ring | None = None) -> CrackTip:
    """Find the tip of a crack along its line, and its stress intensity factors, by a fit of Williams' series.

    The term that is more singular than any crack vanishes where the tip is; the tip is moved until it does.

    Parameters
    ----------
    result : Result
        Measured with the crack as a discontinuity, which may go on beyond its tip.
    line : int
        Which discontinuity, from 1; its last vertex is ahead.
    tip : (x, y), optional
        Where the tip may be, pixels, on the straight end of the line or near it; the line's last vertex by default.
    poisson_ratio : float
        nu, no unit.
    plane : str
        "stress" or "strain".
    ring : Ring, optional
        Which cells are fitted.

    Returns
    -------
    CrackTip
        On the straight end of the line.

    Raises
    ------
    InputError
        Where there is no such line, or no room for the ring, or the case's regularization is that of a composite.
    ConvergenceError
        Where the tip is not found.
    """
    _refuse_composite(result)
    fit = _Fit.prepare(result, get_line(result, line), find_kolosov_constant(poisson_ratio, plane))
    asked = fit.vertices[-1] if tip is None else np.array(tip, dtype=np.float64)
    ahead = fit.measure_ahead(asked)
    away = float(np.linalg.norm(asked - fit.place(ahead)))
    if away > INNER_CELLS * fit.size:
        raise InputError(f"tip ({asked[0]:g}, {asked[1]:g}) px: lies {away:.0f} px beside the straight end of line "
                         f"{line}; give a place on it")
    chosen = ring or Ring()
    _require_radii(chosen)
    found = fit.find_tip(ahead, chosen)
    if found is None:
        raise ConvergenceError(f"{result.path}: line {line}: no crack tip is found from ({asked[0]:.1f}, "
                               f"{asked[1]:.1f}) px on; the line may be open all along, or give another place or ring")
    return _add_scatter(fit, found)


def _refuse_composite(result: Result) -> None:
    """Refuse a material that Williams' series is not of, as far as the case tells; one of long ago knows isotropy."""
    section = get_case(result.attributes).get("regularization") or {}
    if section.get("young_ratio", 1.0) != 1.0 or section.get("shear_ratio") is not None:
        raise InputError(f"{result.path}: was measured as a composite (regularization.young_ratio, shear_ratio), and "
                         "Williams' series is that of an isotropic material: it has neither tip nor factors of this "
                         "one; take the opening along the line")


def _add_scatter(fit: _Fit, found: CrackTip) -> CrackTip:
    """The same with its standard deviations over this ring and smaller ones, of those that find a tip."""
    least = LEAST_RATIO * found.inner
    tips = [found]
    for outer in np.geomspace(least, found.outer, N_RINGS)[:-1] if found.outer >= LEAST_SPAN * least else ():
        with suppress(InputError):
            again = fit.find_tip(fit.measure_ahead(found.position), Ring(found.inner, float(outer)))
            tips += [] if again is None else [again]
    if len(tips) == 1:
        return found
    values = [(fit.measure_ahead(tip.position), tip.opening_factor, tip.sliding_factor, tip.t_stress) for tip in tips]
    return replace(found, scatter=TipDeviations(*np.std(values, axis=0, ddof=1).tolist()), n_rings=len(tips))


def _require_radii(ring: Ring) -> None:
    for name, radius in (("inner", ring.inner), ("outer", ring.outer)):
        if radius is not None and not (np.isfinite(radius) and radius > 0):
            raise InputError(f"{name} = {radius:g} px: give a radius above 0")


@dataclass(frozen=True, eq=False)
class _Fit:
    """Centres of the cells, their displacement, whether that was measured, and weights: the roots of their areas.

    Vertices of the line, and the direction of its straight end; ``noise`` is what the mean displacement of a square
    pixel would have as variance if noise were independent from one to the next.
    """

    points: Array
    displacement: Array
    is_measured: BoolArray
    weights: Array
    kappa: float
    size: float
    vertices: Array
    along: Array
    noise: float

    @classmethod
    def prepare(cls, result: Result, vertices: Array, kappa: float) -> _Fit:
        mesh = result.mesh
        areas = np.abs(measure_areas(mesh))
        placed = place_in_cells(mesh, np.arange(mesh.n_cells), mesh.centroids)
        displacement = interpolate_located(mesh, result.displacement, placed)
        # By area: cells about a tip may be small and many.
        size = float(np.sqrt(find_weighted_median(areas, areas)))
        is_measured = np.isfinite(displacement).all(axis=1)
        start, end = vertices[-2:]
        along = (end - start) / np.linalg.norm(end - start)
        return cls(mesh.centroids, displacement, is_measured, np.sqrt(areas), kappa, size, vertices, along,
                   _find_noise(result, size))

    def place(self, ahead: float) -> Array:
        """The place ahead of the beginning of the line's straight end."""
        return np.asarray(self.vertices[-2] + ahead * self.along)

    def measure_ahead(self, point: Array) -> float:
        """How far ahead of there a point is."""
        return float((point - self.vertices[-2]) @ self.along)

    def find_tip(self, ahead: float, ring: Ring) -> CrackTip | None:
        """Find the tip from a place along the straight end of the line; None where there is none."""
        behind, beyond = -np.inf, np.inf
        for _ in range(MOST_MOVES):
            (inner, outer), limit = self.choose_radii(ring, ahead)
            cells = self.find_cells(self.place(ahead), (inner, outer))
            if len(cells) < FEWEST_CELLS:
                return None
            terms, variances, _ = self.solve(self.place(ahead), (inner, outer), np.arange(-1, HIGHEST_ORDER + 1))
            # d/dx of r^(1/2) is half of r^(-1/2): a tip that is ahead by d adds -d/2 of the latter.
            singular, first = terms[:, 0], terms[:, 2]
            strength = float(first @ first)
            if strength == 0:
                return None
            step = -2 * float(singular @ first) / strength
            behind, beyond = (ahead, beyond) if step > 0 else (behind, ahead)
            if abs(step) <= SAME_TIP or (beyond - behind <= SAME_TIP and abs(step) <= inner):
                variance = 4 * float(variances[:, 0] @ first**2) / strength**2
                (one, two, stress), of_noise, rms = self._find_factors(ahead, (inner, outer))
                moved, _, _ = self._find_factors(ahead + 1.0, (inner, outer))
                of_factors = of_noise + (moved - (one, two, stress)) ** 2 * variance
                noise = TipDeviations(*np.sqrt([variance, *of_factors]).tolist())
                covered = float((self.weights[cells] ** 2).sum() / (np.pi * (outer**2 - inner**2)))
                return CrackTip(self.place(ahead), float(np.arctan2(self.along[1], self.along[0])), float(one),
                                float(two), float(stress), inner, outer, limit, rms, len(cells), covered, UNKNOWN, 1,
                                noise)
            ahead += float(np.clip(step, -inner, inner))
            # Cells that come into the ring by one move and leave it by the next would have it go to and fro.
            if not behind < ahead < beyond:
                ahead = (behind + beyond) / 2
        return None

    def _find_factors(self, ahead: float, radii: tuple[float, float]) -> tuple[Array, Array, float]:
        """K_I, K_II and T of a tip, without the term that vanishes there, their variances by noise; what is left."""
        terms, variances, rms = self.solve(self.place(ahead), radii, np.arange(HIGHEST_ORDER + 1))
        root = float(np.sqrt(2 * np.pi))
        scales, modes, orders = np.array([2 * root, -2 * root, 8.0]), [0, 1, 0], [1, 1, 2]
        return scales * terms[modes, orders], scales**2 * variances[modes, orders], rms

    def choose_radii(self, ring: Ring, ahead: float) -> tuple[tuple[float, float], str]:
        """Radii of the ring about a place, and what the outer one ends at where it is not the one asked for."""
        position = self.place(ahead)
        low, high = self.points.min(axis=0) - self.size / 2, self.points.max(axis=0) + self.size / 2
        (to_left, to_top), (to_right, to_bottom) = position - low, high - position
        (x, y), (bend_x, bend_y) = position, self.vertices[-2]
        rooms = {"the left edge of the mesh": to_left, "the upper edge of the mesh": to_top,
                 "the right edge of the mesh": to_right, "the lower edge of the mesh": to_bottom,
                 f"the line's vertex at ({bend_x:g}, {bend_y:g}) px": ahead}
        nearest = min(rooms, key=lambda name: rooms[name])
        room = float(rooms[nearest])
        inner = INNER_CELLS * self.size if ring.inner is None else ring.inner
        if ring.outer is None:
            outer, limit = OUTER_SHARE * room, f"{OUTER_SHARE:g} of the way to {nearest}"
        elif ring.outer <= room:
            outer, limit = ring.outer, ""
        else:
            outer, limit = room, f"cut from {ring.outer:g} px by {nearest}"
        if outer < LEAST_RATIO * inner:
            raise InputError(f"crack tip at ({x:.1f}, {y:.1f}) px: the mesh and the straight end of the line leave "
                             f"{max(room, 0.0):.0f} px about it, and the ring begins at {inner:.0f} px and has to end "
                             f"at {LEAST_RATIO:g} times that; give another tip, smaller elements, or a smaller inner "
                             "radius")
        return (inner, outer), limit

    def solve(self, position: Array, radii: tuple[float, float], orders: IntArray) -> tuple[Array, Array, float]:
        """Coefficients of u of both modes and their variances by noise, (2, n_orders) each; what is left, pixels."""
        axes = np.stack([self.along, [-self.along[1], self.along[0]]])
        local = (self.points - position) @ axes.T
        inside = self.find_cells(position, radii)
        weights = self.weights[inside]
        terms = evaluate_williams_series(local[inside] / radii[1], orders, self.kappa)
        u = self.displacement[inside] @ axes.T
        matrix = (terms * weights[:, None, None]).reshape(-1, terms.shape[2])
        scaled = np.linalg.lstsq(matrix, (u * weights[:, None]).ravel(), rcond=None)[0]
        left = terms @ scaled - u
        rms = float(np.sqrt((weights[:, None] ** 2 * left**2).sum() / (weights**2).sum()))
        lengths = radii[1] ** (orders / 2)
        # Weights squared are areas: times its weight, each cell has the same variance.
        variances = self.noise * np.linalg.pinv(matrix.T @ matrix, hermitian=True).diagonal()
        return scaled.reshape(2, -1) / lengths, variances.reshape(2, -1) / lengths**2, rms

    def find_cells(self, position: Array, radii: tuple[float, float]) -> NDArray[np.intp]:
        """Measured cells in the ring about a tip."""
        distance = np.linalg.norm(self.points - position, axis=1)
        return np.flatnonzero((distance >= radii[0]) & (distance <= radii[1]) & self.is_measured)


def _find_noise(result: Result, size: float) -> float:
    """Variance of a node's displacement times the area over which noise is as if averaged, px^4; nan if unknown."""
    case = result.attributes.get(CASE, {})
    known = [result.point_data[name] for name in SIGMA_DISPLACEMENT if name in result.point_data]
    level = float(np.sqrt(np.nanmean(np.square(known)))) if known else float(case.get(NOISE_FLOOR, np.nan))
    section = get_case(result.attributes).get("regularization")
    if not section:
        return level**2 * OF_ELEMENTS * size**2
    # A weight given as eta says nothing of wavelengths.
    halves = [float(case.get(f"half_amplitude_{name}_px", np.nan)) for name in ("shear", "longitudinal")]
    return level**2 * OF_WAVES / float(np.mean(np.array(halves) ** -2))

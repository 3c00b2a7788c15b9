"""The tip of a straight crack with free faces, and its stress intensity factors: Williams' series fitted to a field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import ConvergenceError, InputError
from ddic.fracture.opening import get_line
from ddic.functionals.grey_statistics import find_weighted_median
from ddic.io.result_reader import Result
from ddic.io.result_schema import get_case
from ddic.mesh.interpolation import interpolate_located, place_in_cells
from ddic.mesh.quality import measure_areas


def find_kolosov_constant(poisson_ratio: float, plane: str) -> float:
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
    rms : float
        What the series leaves of the displacement, pixels.
    n_cells : int
        Cells in the ring.
    """

    position: Array
    angle: float
    opening_factor: float
    sliding_factor: float
    t_stress: float
    inner: float
    outer: float
    rms: float
    n_cells: int


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
    vertices = get_line(result, line)
    fit = _Fit.prepare(result, find_kolosov_constant(poisson_ratio, plane))
    start, end = vertices[-2:]
    along = (end - start) / np.linalg.norm(end - start)
    asked = end if tip is None else np.array(tip, dtype=np.float64)
    position = start + ((asked - start) @ along) * along
    away = float(np.linalg.norm(asked - position))
    if away > INNER_CELLS * fit.size:
        raise InputError(f"tip ({asked[0]:g}, {asked[1]:g}) px: lies {away:.0f} px beside the straight end of line "
                         f"{line}; give a place on it")
    chosen = ring or Ring()
    _require_radii(chosen)
    for _ in range(MOST_MOVES):
        radii = _choose_radii(fit, chosen, position, float((position - start) @ along))
        if len(fit.find_cells(position, radii)) < FEWEST_CELLS:
            break
        opening, sliding = fit.solve(position, along, radii, np.arange(-1, HIGHEST_ORDER + 1))[0]
        # d/dx of r^(1/2) is half of r^(-1/2): a tip that is ahead by d adds -d/2 of the latter.
        ahead = -2 * (opening[0] * opening[2] + sliding[0] * sliding[2]) / (opening[2] ** 2 + sliding[2] ** 2)
        if abs(ahead) <= SAME_TIP:
            return _describe_tip(fit, position, along, radii)
        position = position + np.clip(ahead, -radii[0], radii[0]) * along
    raise ConvergenceError(f"{result.path}: line {line}: no crack tip is found from ({asked[0]:.1f}, {asked[1]:.1f}) "
                           "px on; the line may be open all along, or give another place or ring")


def _refuse_composite(result: Result) -> None:
    """Refuse a material that Williams' series is not of, as far as the case tells; one of long ago knows isotropy."""
    section = get_case(result.attributes).get("regularization") or {}
    if section.get("young_ratio", 1.0) != 1.0 or section.get("shear_ratio") is not None:
        raise InputError(f"{result.path}: was measured as a composite (regularization.young_ratio, shear_ratio), and "
                         "Williams' series is that of an isotropic material: it has neither tip nor factors of this "
                         "one; take the opening along the line")


def _describe_tip(fit: _Fit, position: Array, along: Array, radii: tuple[float, float]) -> CrackTip:
    """Factors at the tip, without the term that vanishes there."""
    (opening, sliding), rms, n_cells = fit.solve(position, along, radii, np.arange(HIGHEST_ORDER + 1))
    root = float(np.sqrt(2 * np.pi))
    return CrackTip(position, float(np.arctan2(along[1], along[0])), 2 * root * float(opening[1]),
                    -2 * root * float(sliding[1]), 8 * float(opening[2]), radii[0], radii[1], rms, n_cells)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Centres of the cells, their displacement, whether that was measured, and weights: the roots of their areas."""

    points: Array
    displacement: Array
    is_measured: BoolArray
    weights: Array
    kappa: float
    size: float

    @classmethod
    def prepare(cls, result: Result, kappa: float) -> _Fit:
        mesh = result.mesh
        areas = np.abs(measure_areas(mesh))
        placed = place_in_cells(mesh, np.arange(mesh.n_cells), mesh.centroids)
        displacement = interpolate_located(mesh, result.displacement, placed)
        # By area: cells about a tip may be small and many.
        size = float(np.sqrt(find_weighted_median(areas, areas)))
        is_measured = np.isfinite(displacement).all(axis=1)
        return cls(mesh.centroids, displacement, is_measured, np.sqrt(areas), kappa, size)

    def solve(self, position: Array, along: Array, radii: tuple[float, float],
              orders: IntArray) -> tuple[tuple[Array, Array], float, int]:
        """Coefficients of u of both modes, (n_orders,) each; what is left, pixels; and the number of cells."""
        axes = np.stack([along, [-along[1], along[0]]])
        local = (self.points - position) @ axes.T
        inside = self.find_cells(position, radii)
        weights = self.weights[inside]
        terms = evaluate_williams_series(local[inside] / radii[1], orders, self.kappa)
        u = self.displacement[inside] @ axes.T
        matrix = (terms * weights[:, None, None]).reshape(-1, terms.shape[2])
        scaled = np.linalg.lstsq(matrix, (u * weights[:, None]).ravel(), rcond=None)[0]
        left = terms @ scaled - u
        rms = float(np.sqrt((weights[:, None] ** 2 * left**2).sum() / (weights**2).sum()))
        opening, sliding = scaled.reshape(2, -1) / radii[1] ** (orders / 2)
        return (opening, sliding), rms, len(inside)

    def find_cells(self, position: Array, radii: tuple[float, float]) -> NDArray[np.intp]:
        """Measured cells in the ring about a tip."""
        distance = np.linalg.norm(self.points - position, axis=1)
        return np.flatnonzero((distance >= radii[0]) & (distance <= radii[1]) & self.is_measured)


def _require_radii(ring: Ring) -> None:
    for name, radius in (("inner", ring.inner), ("outer", ring.outer)):
        if radius is not None and not (np.isfinite(radius) and radius > 0):
            raise InputError(f"{name} = {radius:g} px: give a radius above 0")


def _choose_radii(fit: _Fit, ring: Ring, position: Array, straight: float) -> tuple[float, float]:
    low, high = fit.points.min(axis=0) - fit.size / 2, fit.points.max(axis=0) + fit.size / 2
    room = float(min((position - low).min(), (high - position).min(), straight))
    inner = INNER_CELLS * fit.size if ring.inner is None else ring.inner
    outer = OUTER_SHARE * room if ring.outer is None else min(ring.outer, room)
    if outer < LEAST_RATIO * inner:
        raise InputError(f"crack tip at ({position[0]:.1f}, {position[1]:.1f}) px: the mesh and the straight end of "
                         f"the line leave {max(room, 0.0):.0f} px about it, and the ring begins at {inner:.0f} px and "
                         f"has to end at {LEAST_RATIO:g} times that; give another tip, smaller elements, or a smaller "
                         "inner radius")
    return inner, outer

"""Where a simulation lies in the image: given, or fitted to the measured field; and the rigid motion between both.

The specimen moves with the machine by what no simulation knows. With the simulation's own displacement u_s(X), turned
by R(a) and moved by t to the place x = R(a) X + t, the field that is compared is

    u(x) = R(b) (x + R(a) u_s(X) - c) + c + s - x,

where b and s, a rotation about the middle c of the measured nodes and a translation, make the rigid motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.mesh.interpolation import CellSearch, interpolate_located
from ddic.mesh.mesh import Mesh
from ddic.mesh.rotation import Rotation, fit_rotation

LEAST_COVERED = 0.1
"""Share of the measured nodes that a simulation must cover for it to be placed by them."""

STEP = 1e-2
"""Pixels by which a placement is varied to differentiate by it: much less than an element, much more than rounding."""

LEAST_ERROR = 1e-3
"""Pixels by which a simulation differs from a measured field at least, which tell how well a place is known."""

LARGEST_DEVIATION = 5.0
"""Standard deviation of a fitted place, pixels, from which on the field does not tell it. A larger value lets the place
of a nearly uniform field wander."""


@dataclass(frozen=True, eq=False)
class PlacedField:
    """A simulated displacement at its place in the image, with a rigid motion.

    Attributes
    ----------
    search : CellSearch
        Of its cells, in pixels as the mapping has put them.
    displacement : (n_nodes, dim) array
        Of its nodes, without the rigid motion, pixels.
    turn : Rotation
        R(a), by which it is turned about the image's origin.
    offset : (dim,) array
        t, pixels.
    centre : (dim,) array
        c, pixels.
    rotation : Rotation
        R(b), of the rigid motion.
    translation : (dim,) array
        s, pixels.
    """

    search: CellSearch
    displacement: Array
    turn: Rotation
    offset: Array
    centre: Array
    rotation: Rotation
    translation: Array

    @classmethod
    def as_given(cls, mesh: Mesh, displacement: Array) -> PlacedField:
        """Take a simulation where it is, and its displacement as it is."""
        zero, none = np.zeros(mesh.dim), Rotation.none(mesh.dim)
        return cls(CellSearch(mesh), displacement, none, zero, zero, none, zero)

    def at(self, points: Array) -> Array:
        """Interpolate the displacement at points of the image, (n, dim), pixels; nan where the simulation is not."""
        located = self.search.locate(self.turn.apply_inverse(points - self.offset))
        moved = points + self.turn.apply(interpolate_located(self.search.mesh, self.displacement, located))
        return self.rotation.apply(moved - self.centre) + self.centre + self.translation - points

    def describe(self) -> str:
        """Say where it lies and how it has moved."""
        moved = ", ".join(f"{value:.4g}" for value in self.translation)
        text = f"rigid motion of ({moved}) px and {np.rad2deg(self.rotation.angle):.4g} degrees"
        if self.turn.angle == 0 and not self.offset.any():
            return text
        offset = ", ".join(f"{value:.4g}" for value in self.offset)
        return f"placed {np.rad2deg(self.turn.angle):.4g} degrees and ({offset}) px from where it was given; {text}"


def fit_rigid_motion_to(placed: PlacedField, points: Array, measured: Array) -> PlacedField:
    """Fit the rigid motion to the displacement that was measured at points of the image, both (n, dim), pixels.

    Raises InputError where the simulation covers too few of them.
    """
    dim = points.shape[1]
    still = replace(placed, rotation=Rotation.none(dim), translation=np.zeros(dim))
    simulated = points + still.at(points)
    is_known = np.isfinite(simulated).all(axis=1) & np.isfinite(measured).all(axis=1)
    if is_known.sum() < max(LEAST_COVERED * len(points), 3):
        raise InputError(f"the simulation covers {is_known.sum()} of {len(points)} nodes of the mesh; look at "
                         "simulation.mapping (scale, rotation_degrees, translation, y_up)")
    simulated, moved = simulated[is_known], (points + measured)[is_known]
    centre = simulated.mean(axis=0)
    rotation = Rotation.from_matrix(fit_rotation((moved - moved.mean(axis=0)).T @ (simulated - centre)))
    return replace(still, centre=centre, rotation=rotation, translation=moved.mean(axis=0) - centre)


def fit_placement(placed: PlacedField, points: Array, measured: Array) -> PlacedField:
    """Fit where the simulation lies, and its rigid motion, to the displacement that was measured at points.

    Both are (n, dim), pixels; the fit begins where it is. Raises InputError where the simulation covers too few of
    them, or where the field does not tell its place: a uniform strain is the same everywhere.
    """
    from scipy.optimize import least_squares

    n_turns = len(placed.turn.vector)
    # Turns in units in which they move the mesh's edge by a pixel.
    radius = float(np.ptp(points, axis=0).max()) / 2
    middle = points.mean(axis=0)

    def place(parameters: Array) -> PlacedField:
        turn = Rotation(placed.turn.vector + parameters[:n_turns] / radius)
        # About the middle of the points: turns and offsets are independent then.
        offset = middle + parameters[n_turns:] + turn.apply(placed.turn.apply_inverse(placed.offset - middle))
        return fit_rigid_motion_to(replace(placed, turn=turn, offset=offset), points, measured)

    def find_difference(parameters: Array) -> Array:
        difference = (place(parameters).at(points) - measured).ravel()
        return np.where(np.isfinite(difference), difference, 0.0)

    found = least_squares(find_difference, np.zeros(n_turns + len(middle)), diff_step=STEP)
    n_free = max(len(found.fun) - len(found.x), 1)
    error = max(float(np.sqrt(found.fun @ found.fun / n_free)), LEAST_ERROR)
    deviation = error / max(np.linalg.svd(found.jac, compute_uv=False)[-1], 1e-300)
    if deviation > LARGEST_DEVIATION:
        raise InputError("simulation.fit: the field changes too little from place to place to tell where the "
                         f"simulation lies (to {deviation:.2g} px); give simulation.mapping, and fit = \"motion\"")
    return place(found.x)

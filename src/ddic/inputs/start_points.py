"""Displacements at points that a user gives to start from."""

from dataclasses import dataclass

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.case.schema import StartSection
from ddic.errors import InputError
from ddic.io.text_files import read_point_table
from ddic.mesh.interpolation import locate
from ddic.mesh.mesh import Mesh


@dataclass(frozen=True, eq=False)
class StartPoints:
    """Displacements at points.

    Attributes
    ----------
    points, displacement : (n, 2) array
        Where they are in the reference image, and how far they move, pixels.
    name : str
        Where they come from, for the log and for messages.
    rows : (n,) array of int64, optional
        Rows of the table that they were read from.
    """

    points: Array
    displacement: Array
    name: str
    rows: IntArray | None = None

    def describe(self) -> str:
        """Say for the log what they are."""
        n = len(self.points)
        return f"displacement at {n} {'point' if n == 1 else 'points'} of {self.name}"

    def describe_point(self, number: int) -> str:
        """Say for messages which point it is; the number counts from 0."""
        return f"{self.name}[{number}]" if self.rows is None else f"{self.name}: row {self.rows[number]}"


def load_start_points(section: StartSection) -> StartPoints | None:
    """Load the points that a case starts from; None where it gives none.

    Raises InputError where a table of points is missing or holds something else.
    """
    if section.from_points is not None:
        values, rows = read_point_table(section.from_points)
        return StartPoints(values[:, :2], values[:, 2:], str(section.from_points), rows)
    if section.points is not None:
        pairs = np.array(section.points, dtype=np.float64)
        return StartPoints(pairs[:, :2], pairs[:, 2:] - pairs[:, :2], "start.points")
    return None


def check_start_points(given: StartPoints, width: int, height: int) -> None:
    """Check that points lie in the reference image, and are moved by no more than its diagonal.

    Raises InputError with the first point that does not.
    """
    is_finite = np.isfinite(given.points).all(axis=1) & np.isfinite(given.displacement).all(axis=1)
    if not is_finite.all():
        number = int(np.flatnonzero(~is_finite)[0])
        raise InputError(f"{given.describe_point(number)}: holds a value that is not finite; leave the point out")
    edge = np.array([width, height]) - 0.5
    is_inside = (given.points >= -0.5).all(axis=1) & (given.points <= edge).all(axis=1)
    if not is_inside.all():
        number = int(np.flatnonzero(~is_inside)[0])
        x, y = given.points[number]
        raise InputError(f"{given.describe_point(number)}: ({x:g}, {y:g}) lies outside the reference image of "
                         f"{width} x {height} px; give x (column) and y (row) in pixels")
    lengths = np.hypot(*given.displacement.T)
    farthest = int(lengths.argmax())
    if lengths[farthest] > np.hypot(width, height):
        raise InputError(f"{given.describe_point(farthest)}: moves by {lengths[farthest]:g} px, out of the image of "
                         f"{width} x {height} px; give displacements in pixels")


def require_points_inside(given: StartPoints, mesh: Mesh) -> None:
    """Refuse, with an InputError, points none of which lies in the region."""
    if (locate(mesh, given.points).cells < 0).all():
        raise InputError(f"{given.name}: none of {len(given.points)} points lies in the mesh; give one at least that "
                         "does, pixels of the reference image")

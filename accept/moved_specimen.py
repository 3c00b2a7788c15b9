"""Whether a measurement is believed, and how finely it is made, wherever the specimen has moved."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import ddic
from accept.table import Scale
from bench.support.rows import Row

Image = NDArray[np.uint8]

MOVED = (150, -120)
"""Pixels that the specimen of the first check is moved by."""

SHIFTS = (0, 30, 100, 300)
"""Pixels along x that disturbed pairs are moved by."""

SAME_PX = 1e-3
"""Largest difference at a node between the moved field and the one at rest."""

WRONG_PX = 0.3
"""Largest error of a node of a cell that is not marked."""

MOST_MARKED = 0.8
"""Share of the cells of a field that converged that may be marked: of more, next to nothing was measured."""

MOST_NEEDLESS = 0.02
"""Share of the cells that may be marked though they are right and nothing near them is disturbed."""

ELEMENT = 16
"""Side of the elements, pixels."""

BLUR, CRACK, OCCLUSION, DIRT = 9, 20, 80, 18
"""Sides and widths of what disturbs, pixels."""


@dataclass(frozen=True)
class Specimen:
    """A speckled pair in the middle of a larger picture, and its mesh.

    Attributes
    ----------
    reference, deformed : Image
        At rest.
    box : (x0, y0, x1, y1)
        The mesh's region, pixels.
    """

    reference: Image
    deformed: Image
    box: tuple[int, int, int, int]

    def move(self, image: Image, shift: tuple[int, int]) -> Image:
        """Shift an image by whole pixels, to the last bit the same."""
        return np.asarray(np.roll(image, shift[::-1], (0, 1)), dtype=np.uint8)

    def measure(self, deformed: Image, shift: tuple[int, int], method: str, wavelength: int) -> ddic.Result:
        """Measure the specimen moved by whole pixels, with defaults but for method and wavelength."""
        options: dict[str, Any] = {"solver": {"method": method}}
        if method == "dual":
            options["solver"]["subdomains"] = 9
        if wavelength:
            options["regularization"] = {"cut_off_wavelength": wavelength}
        return ddic.measure((self.reference, self.move(deformed, shift)), ddic.structured_mesh(self.box, ELEMENT),
                            **options)


def displace(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Displacement of the specimen at rest (n, 2), pixels."""
    x, y = points.T
    return np.column_stack([0.8 * np.sin(x / 70) * np.cos(y / 90) + 0.002 * x, 0.6 * np.cos(x / 80) - 0.001 * y])


@cache
def make_specimen(side: int, margin: int) -> Specimen:
    """Render a specimen of side x side px with a margin around."""
    size = side + 2 * margin
    reference, deformed = ddic.make_synthetic_pair(displace, (size, size), noise=2.0, seed=3)
    return Specimen(reference, deformed, (margin, margin, margin + side, margin + side))


def _choose_specimen(scale: Scale, farthest: int) -> Specimen:
    return make_specimen(128, farthest + 60) if scale.smoke else make_specimen(512, farthest + 60)


def measure_moved(scale: Scale) -> list[Row]:
    """Compare the field of a moved specimen with that at rest, by two methods, with and without regularization."""
    specimen = _choose_specimen(scale, max(map(abs, MOVED)))
    found = {}
    for method in ("conjugate_gradient", "dual"):
        for wavelength in (0, 128):
            at_rest, moved = (specimen.measure(specimen.deformed, shift, method, wavelength).displacement
                              for shift in ((0, 0), MOVED))
            found[f"{method}, l_c = {wavelength}"] = float(np.linalg.norm(moved - MOVED - at_rest, axis=1).max())
    listed = "; ".join(f"{name}: {difference:.1e} px" for name, difference in found.items())
    return [Row(f"specimen moved by {MOVED} px beside the same at rest: largest difference at a node",
                f"<= {SAME_PX} px", listed, max(found.values()) <= SAME_PX)]


def dim(image: Image, box: tuple[int, int, int, int]) -> Image:
    """Take two fifths of the brightness."""
    return np.asarray(np.round(0.6 * image), dtype=np.uint8)


def cover(image: Image, box: tuple[int, int, int, int]) -> Image:
    """Hold something before the specimen."""
    return _paste(image, box, np.full((OCCLUSION, OCCLUSION), 30, np.uint8))


def replace_speckle(image: Image, box: tuple[int, int, int, int]) -> Image:
    """Put other speckle in the specimen's place."""
    side = OCCLUSION + 40
    return _paste(image, box, ddic.make_synthetic_pair(np.zeros_like, (side, side), seed=99)[0])


def stain(image: Image, box: tuple[int, int, int, int]) -> Image:
    """Put dirt on the lens."""
    stained = image.copy()
    for x, y in np.random.default_rng(7).uniform(box[:2], box[2:], (12, 2)):
        cv2.circle(stained, (int(x), int(y)), DIRT // 2, 20.0, -1)
    return stained


def blur(image: Image, box: tuple[int, int, int, int]) -> Image:
    """Take the picture out of focus."""
    return np.asarray(cv2.blur(image, (BLUR, BLUR)), dtype=np.uint8)


def crack(image: Image, box: tuple[int, int, int, int]) -> Image:
    """Open a crack across the specimen; the lower part moves down."""
    middle = _find_middle(box)
    opened = np.full_like(image, 15)
    opened[:middle] = image[:middle]
    opened[middle + CRACK:] = image[middle:-CRACK]
    return opened


def _paste(image: Image, box: tuple[int, int, int, int], patch: Image) -> Image:
    pasted = image.copy()
    x, y = (box[0] + box[2] - len(patch)) // 2, (box[1] + box[3] - len(patch)) // 2
    pasted[y: y + len(patch), x: x + len(patch)] = patch
    return pasted


DISTURBANCES: Mapping[str, Callable[[Image, tuple[int, int, int, int]], Image]] = {
    "brightness x 0.6": dim, f"occlusion of {OCCLUSION} px": cover, "foreign speckle": replace_speckle, "dirt": stain,
    f"blur of {BLUR} px": blur, f"crack of {CRACK} px": crack}

SMOKE_DISTURBANCES = ("brightness x 0.6", f"blur of {BLUR} px")


def measure_disturbed(scale: Scale) -> list[Row]:
    """Measure disturbed pairs, moved by several distances, with and without regularization."""
    shifts = SHIFTS[:2] if scale.smoke else SHIFTS
    specimen = _choose_specimen(scale, max(shifts))
    names = SMOKE_DISTURBANCES if scale.smoke else tuple(DISTURBANCES)
    return [_judge(name, specimen, shifts) for name in names]


def _judge(name: str, specimen: Specimen, shifts: tuple[int, ...]) -> Row:
    disturbed = DISTURBANCES[name](specimen.deformed, specimen.box)
    said, same, worst = [], True, Believed(0.0, 0.0, 0.0)
    for wavelength in (0, 128):
        verdicts = []
        for shift in shifts:
            try:
                result = specimen.measure(disturbed, (shift, 0), "conjugate_gradient", wavelength)
            except ddic.ConvergenceError:
                verdicts.append("refused")
                continue
            verdicts.append("converged")
            worst = worst.join(judge_marks(result, specimen, name, (shift, wavelength)))
        same = same and len(set(verdicts)) == 1
        said.append(f"l_c = {wavelength}: {', '.join(verdicts)}")
    moved = ", ".join(map(str, shifts))
    return Row(f"{name}, moved by {moved} px, method = \"conjugate_gradient\": verdict; of those that converge the "
               "worst node of a cell that is not marked, the share of marked cells, and of those that need not be",
               f"one verdict whatever the shift; <= {WRONG_PX} px; <= {MOST_MARKED:.0%}; <= {MOST_NEEDLESS:.0%}",
               f"{'; '.join(said)}; {worst.describe()}", same and worst.holds)


@dataclass(frozen=True)
class Believed:
    """What the marks of a field's cells are worth.

    Attributes
    ----------
    worst : float
        Largest error of a node of a cell that is not marked, pixels.
    marked : float
        Share of the cells that are marked.
    needless : float
        Share of the cells that are marked though no node of theirs is off by more than WRONG_PX, and none beside them,
        or within twice the cut-off wavelength, is disturbed.
    """

    worst: float
    marked: float
    needless: float

    @property
    def holds(self) -> bool:
        """Whether all is within the bounds."""
        return self.worst <= WRONG_PX and self.marked <= MOST_MARKED and self.needless <= MOST_NEEDLESS

    def join(self, other: Believed) -> Believed:
        """The worst of both."""
        return Believed(max(self.worst, other.worst), max(self.marked, other.marked),
                        max(self.needless, other.needless))

    def describe(self) -> str:
        """Say it in the order of the bounds."""
        return f"{self.worst:.3f} px; {self.marked:.1%}; {self.needless:.1%}"


def judge_marks(result: ddic.Result, specimen: Specimen, name: str, how: tuple[int, int]) -> Believed:
    """Compare the marks of a field's cells with its errors and with where the pair is disturbed.

    Parameters
    ----------
    result : Result
        Converged.
    specimen : Specimen
        What was measured.
    name : str
        Of the disturbance.
    how : tuple of int
        By which the specimen was moved along x, and the cut-off wavelength, 0 for none; pixels.

    Returns
    -------
    Believed
        Worst node, and shares of cells.
    """
    shift, wavelength = how
    cells, marked = result.mesh.connectivity.reshape(-1, 4), result.fields["doubtful"] != 0
    errors = np.min([np.linalg.norm(result.displacement - (shift, 0) - exact, axis=1)
                     for exact in _list_true_fields(result.mesh.nodes, specimen, name)], axis=0)
    of_cells = errors[cells].max(axis=1)
    is_disturbed = _find_disturbed_cells(result.mesh, specimen, name)
    # Mechanics carry it on over a cut-off wavelength; cells are pulled so far away, and marked so far about these.
    reach = max(2.0 * wavelength, 1.5 * ELEMENT)
    is_near = np.zeros(len(cells), dtype=bool)
    for centre in result.mesh.centroids[is_disturbed]:
        is_near |= np.abs(result.mesh.centroids - centre).max(axis=1) <= reach
    needless = marked & (of_cells <= WRONG_PX) & ~is_near
    return Believed(float(of_cells[~marked].max(initial=0.0)), float(marked.mean()), float(needless.mean()))


def _list_true_fields(nodes: NDArray[np.float64], specimen: Specimen, name: str) -> list[NDArray[np.float64]]:
    """Displacements that nodes have; where a crack runs through a node, two, of either side."""
    exact = displace(nodes)
    if DISTURBANCES[name] is not crack:
        return [exact]
    beyond = nodes[:, 1] + exact[:, 1] - _find_middle(specimen.box)
    opened = exact + np.array([0.0, CRACK])
    return [np.where((beyond >= side)[:, None], opened, exact) for side in (-1.0, 1.0)]


def _find_disturbed_cells(mesh: ddic.Mesh, specimen: Specimen, name: str) -> NDArray[np.bool_]:
    """Cells of which the deformed image at rest shows something else than the specimen as it was, (n_cells,)."""
    cells = mesh.connectivity.reshape(-1, 4)
    moved = mesh.nodes + displace(mesh.nodes)
    low, high = moved[cells].min(axis=1), moved[cells].max(axis=1)
    if DISTURBANCES[name] in (dim, blur):
        # All of the image is another one, and none of it hides the specimen.
        return np.zeros(len(cells), dtype=bool)
    if DISTURBANCES[name] is crack:
        middle = _find_middle(specimen.box)
        return np.asarray((low[:, 1] <= middle) & (high[:, 1] >= middle))
    changed = DISTURBANCES[name](specimen.deformed, specimen.box) != specimen.deformed
    return np.array([changed[y0:y1 + 1, x0:x1 + 1].any() for (x0, y0), (x1, y1)
                     in zip(np.floor(low).astype(int), np.ceil(high).astype(int), strict=True)])


def _find_middle(box: tuple[int, int, int, int]) -> int:
    """Row at which the specimen cracks."""
    return (box[1] + box[3]) // 2

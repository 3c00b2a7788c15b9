"""Pairs of which a part is hidden, dirty, bright, blurred, out of the image or bare: what is measured and marked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

import ddic
from accept.support.deformed_pair import Camera, Deformation, make_linear, make_rotation, render_deformed
from accept.table import Scale
from bench.support.rows import Row, append_result
from ddic.images.window import Window
from ddic.mesh.raster import rasterize
from ddic.synth.speckle import SpeckleTexture

Array = NDArray[np.float64]

SIDE = 600
"""Side of the images, pixels."""

REGION = (60.0, 60.0, 540.0, 540.0)
"""Of the mesh, pixels."""

CENTRE = np.array([293.0, 307.0])
"""Of what hides a part of the deformed image, pixels."""


@dataclass(frozen=True, eq=False)
class SpoiltPair:
    """Images, the displacement that they were drawn with, and what of them shows the specimen.

    Attributes
    ----------
    reference, deformed : (SIDE, SIDE) uint8 array
        Grey levels.
    deformation : Deformation
        The truth.
    hidden_reference, hidden_deformed : (SIDE, SIDE) bool array
        Where an image does not show the specimen's texture.
    """

    reference: NDArray[np.uint8]
    deformed: NDArray[np.uint8]
    deformation: Deformation
    hidden_reference: NDArray[np.bool_]
    hidden_deformed: NDArray[np.bool_]

    def count_hidden(self, mesh: ddic.Mesh) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Count the pixels of each cell, and those that either image does not show.

        Parameters
        ----------
        mesh : Mesh
            Pixels.

        Returns
        -------
        n_pixels, n_hidden : (n_cells,) arrays
            Of each cell.
        """
        y, x = np.mgrid[0:SIDE, 0:SIDE].astype(float)
        points = np.column_stack([x.ravel(), y.ravel()])
        moved = np.rint(points + self.deformation.displacement(points)).astype(int)
        is_inside = ((moved >= 0) & (moved < SIDE)).all(axis=1)
        column, row = np.clip(moved, 0, SIDE - 1).T
        hidden = self.hidden_reference.ravel() | ~is_inside | self.hidden_deformed[row, column]
        raster = rasterize(mesh)
        is_hidden = hidden.reshape(SIDE, SIDE).astype(np.uint8)
        return raster.pixel_counts, raster.sum_by_cell(is_hidden, Window.of_size(SIDE, SIDE))


def draw_clean(translation: tuple[float, float] = (5.3, -7.2)) -> SpoiltPair:
    """Draw a pair of a small rotation, strain and translation, with noise of 2 grey levels.

    Parameters
    ----------
    translation : (float, float)
        Pixels.

    Returns
    -------
    SpoiltPair
        Nothing of it is spoilt.
    """
    gradient = make_rotation(1.0) + np.array([[0.004, 0.0], [0.0, -0.002]])
    deformation = make_linear(gradient, np.full(2, SIDE / 2), np.array(translation))
    reference, deformed = render_deformed(deformation, Camera((SIDE, SIDE)))
    nothing = np.zeros((SIDE, SIDE), dtype=bool)
    return SpoiltPair(reference, deformed, deformation, nothing, nothing)


def _digitise(levels: Array) -> NDArray[np.uint8]:
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def _change_deformed(change: Callable[[Array], Array]) -> SpoiltPair:
    clean = draw_clean()
    changed = _digitise(change(clean.deformed.astype(float)))
    return SpoiltPair(clean.reference, changed, clean.deformation, clean.hidden_reference, clean.hidden_deformed)


def _reflect_and_hide() -> SpoiltPair:
    """Where the reflection saturates, no speckle is seen."""
    changed = _change_deformed(_reflect)
    return SpoiltPair(changed.reference, changed.deformed, changed.deformation, changed.hidden_reference,
                      changed.deformed == 255)


def _brighten_in_a_ramp(levels: Array) -> Array:
    x = np.arange(SIDE) / SIDE
    return np.asarray(levels * (0.8 + 0.3 * x) + 20.0 * x[:, None])


def _reflect(levels: Array) -> Array:
    y, x = np.mgrid[0:SIDE, 0:SIDE]
    squared = (x - CENTRE[0])**2 + (y - CENTRE[1])**2
    return np.asarray(levels + 120.0 * np.exp(-squared / (2 * 40.0**2)))


def _change_brightness(gain: float, offset: float) -> SpoiltPair:
    return _change_deformed(lambda levels: gain * levels + offset)


def _hide(size: int, kind: str) -> SpoiltPair:
    """A square of the deformed image is black, grey or shows another specimen."""
    clean = draw_clean()
    low = (CENTRE - size / 2).astype(int)
    box = np.s_[low[1]:low[1] + size, low[0]:low[0] + size]
    y, x = np.mgrid[box].astype(float)
    covers = {"black": np.zeros(x.shape), "grey": np.full(x.shape, 127.0),
              "other speckle": 255.0 * SpeckleTexture(77).grey(x, y)}
    noise = 2.0 * np.random.default_rng(5).standard_normal(x.shape)
    deformed, hidden = clean.deformed.copy(), clean.hidden_deformed.copy()
    deformed[box] = _digitise(covers[kind] + noise)
    hidden[box] = True
    return SpoiltPair(clean.reference, deformed, clean.deformation, clean.hidden_reference, hidden)


def _soil() -> SpoiltPair:
    """Dirt on the lens: at the same pixels of both images."""
    clean = draw_clean()
    random = np.random.default_rng(11)
    dirt = np.zeros((SIDE, SIDE), dtype=np.uint8)
    for _ in range(20):
        x, y = random.integers(70, SIDE - 70, 2)
        cv2.circle(dirt, (int(x), int(y)), int(random.integers(2, 7)), 1, -1)
    transmission = 1.0 - 0.7 * cv2.GaussianBlur(dirt.astype(float), (0, 0), 1.0)
    hidden = transmission < 0.98
    return SpoiltPair(_digitise(clean.reference * transmission), _digitise(clean.deformed * transmission),
                      clean.deformation, hidden, hidden)


def _blur(length: int) -> SpoiltPair:
    """The specimen moved along x while the deformed image was taken; noise is that of the camera."""
    blurred = _change_deformed(lambda levels: uniform_filter1d(levels, length, axis=1))
    noise = 2.0 * np.random.default_rng(7).standard_normal((SIDE, SIDE))
    return SpoiltPair(blurred.reference, _digitise(blurred.deformed + noise), blurred.deformation,
                      blurred.hidden_reference, blurred.hidden_deformed)


def _blank_half() -> SpoiltPair:
    """The right half of the specimen bears no speckle."""
    clean = draw_clean()
    y, x = np.mgrid[0:SIDE, 0:SIDE].astype(float)
    random = np.random.default_rng(9)
    edge = SIDE / 2
    points = np.column_stack([x.ravel(), y.ravel()])
    middle = np.full(2, SIDE / 2)
    # Where the linear deformation brings each pixel of the deformed image from.
    tangent = np.eye(2) + clean.deformation.gradient(middle[None])[0]
    origins = middle + (points - middle - clean.deformation.displacement(middle[None])) @ np.linalg.inv(tangent).T
    is_blank_f, is_blank_g = x > edge, origins[:, 0].reshape(SIDE, SIDE) > edge
    images = []
    for image, is_blank in ((clean.reference, is_blank_f), (clean.deformed, is_blank_g)):
        plain = _digitise(120.0 + 2.0 * random.standard_normal((SIDE, SIDE)))
        images.append(np.where(is_blank, plain, image))
    return SpoiltPair(images[0], images[1], clean.deformation, is_blank_f, is_blank_g)


BRIGHTNESS: Mapping[str, Callable[[], SpoiltPair]] = {
    "brightness x 0.9 + 5": partial(_change_brightness, 0.9, 5.0),
    "brightness x 0.6 + 20": partial(_change_brightness, 0.6, 20.0),
    "brightness + 60, clipped": partial(_change_brightness, 1.0, 60.0),
    "a ramp of brightness": partial(_change_deformed, _brighten_in_a_ramp),
    "a reflection, clipped": _reflect_and_hide,
}

HIDDEN: Mapping[str, Callable[[], SpoiltPair]] = {
    f"{size} px of {kind}": partial(_hide, size, kind)
    for size in (40, 80) for kind in ("black", "grey", "other speckle")}

OTHERS: Mapping[str, Callable[[], SpoiltPair]] = {
    "dirt on the lens": _soil,
    **{f"{pixels} px out of the image": partial(draw_clean, (60.0 + pixels, -7.2)) for pixels in (60, 120, 240)},
    "half of it blank": _blank_half,
}

BLURRED: Mapping[str, Callable[[], SpoiltPair]] = {
    f"motion blur of {length} px": partial(_blur, length) for length in (5, 9, 15)}


ELEMENT = 20
"""Side of the elements, pixels."""

WAVELENGTHS = (None, 80.0)
"""Cut-off wavelengths, pixels: without regularization and with."""

OF_FLOOR = 1.5
"""Largest RMS error, times that of the clean pair at the same nodes."""

HOPELESS = "motion blur of 15 px"
"""Leaves nodes up to 3 px off, and none that noise alone does not move by more than 0.15 px."""

MOST_HIDDEN = 0.5
"""Share of a cell's pixels that are hidden from which on it has to be marked."""


@dataclass(frozen=True)
class Found:
    """What a measurement of a spoilt pair came to.

    Attributes
    ----------
    ratio : float
        RMS error at the nodes of cells without a hidden pixel, relative to that of the clean pair there.
    rms, largest : float
        The error, pixels.
    n_unmarked : int
        Cells most of whose pixels are hidden that are not marked.
    n_lost : int
        Cells that are excluded though neither they nor a neighbour holds a hidden pixel.
    """

    ratio: float
    rms: float
    largest: float
    n_unmarked: int
    n_lost: int


def measure_brightness(scale: Scale) -> list[Row]:
    """Measure pairs whose light changes."""
    return _judge_all("light changes", BRIGHTNESS, scale)


def measure_hidden(scale: Scale) -> list[Row]:
    """Measure pairs of which a square is hidden."""
    return _judge_all("a square of the deformed image is hidden", HIDDEN, scale)


def measure_other_spoilt(scale: Scale) -> list[Row]:
    """Measure pairs with dirt on the lens, partly out of the image, or half blank."""
    return _judge_all("dirt, out of the image, blank", OTHERS, scale)


def _judge_all(what: str, cases: Mapping[str, Callable[[], SpoiltPair]], scale: Scale) -> list[Row]:
    rows = []
    for wavelength in WAVELENGTHS[-1:] if scale.smoke else WAVELENGTHS:
        options = _options(wavelength)
        told, holds = [], True
        for name in list(cases)[:1] if scale.smoke else cases:
            found = _measure(name, cases[name](), options)
            if isinstance(found, str):
                told.append(f"{name}: refused ({found})")
                holds = False
                continue
            good = found.ratio <= OF_FLOOR and found.n_unmarked == 0 and found.n_lost == 0
            holds &= good
            told.append(f"{name}: {found.ratio:.2f} times, largest {found.largest:.2f} px"
                        + ("" if good else f" (MISSED; {found.n_unmarked} not marked, {found.n_lost} lost)"))
        rows.append(Row(f"{what}, {_describe(wavelength)}", f"RMS error where the specimen is seen at most {OF_FLOOR} "
                        "times that of the clean pair, hidden cells marked, at most one row of neighbours lost",
                        "; ".join(told), holds))
    return rows


def measure_blur(scale: Scale) -> list[Row]:
    """Measure pairs whose deformed image is blurred by motion."""
    rows = []
    for wavelength in WAVELENGTHS[-1:] if scale.smoke else WAVELENGTHS:
        told, holds = [], True
        for name in list(BLURRED)[:1] if scale.smoke else BLURRED:
            found = _measure(name, BLURRED[name](), _options(wavelength))
            holds &= isinstance(found, str) == (name == HOPELESS)
            told.append(f"{name}: " + (found if isinstance(found, str) else
                                       f"RMS {found.rms:.3f} px, {found.ratio:.1f} times, largest {found.largest:.1f}"))
        rows.append(Row(f"motion blur, {_describe(wavelength)}", f"converges, but {HOPELESS} is refused; reported",
                        "; ".join(told), holds))
    return rows


def _options(wavelength: float | None) -> dict[str, Any]:
    return {} if wavelength is None else {"regularization": {"cut_off_wavelength": wavelength}}


def _describe(wavelength: float | None) -> str:
    return "without regularization" if wavelength is None else f"l_c = {wavelength:g} px"


def _measure(name: str, pair: SpoiltPair, options: dict[str, Any]) -> Found | str:
    """Errors where the specimen is seen; a string where the measurement was refused."""
    mesh = ddic.structured_mesh(REGION, ELEMENT)
    clean = draw_clean()
    try:
        result = ddic.measure((pair.reference, pair.deformed), mesh, **options)
    except ddic.DdicError as error:
        return str(error).splitlines()[0]
    at_rest = ddic.measure((clean.reference, clean.deformed), mesh, **options)
    n_pixels, n_hidden = pair.count_hidden(mesh)
    cells = mesh.cells
    is_touched = n_hidden > 0
    seen = np.unique(cells[~is_touched])
    off = result.at(mesh.nodes)[seen] - pair.deformation.displacement(mesh.nodes[seen])
    floor = at_rest.at(mesh.nodes)[seen] - clean.deformation.displacement(mesh.nodes[seen])
    rms = float(np.sqrt(np.mean(off**2)))
    excluded = result.cell_data["excluded"] > 0
    marked = excluded | (result.cell_data["doubtful"] > 0)
    has_touched_neighbour = np.isin(cells, np.unique(cells[is_touched])).any(axis=1)
    found = Found(rms / float(np.sqrt(np.mean(floor**2))), rms, float(np.linalg.norm(off, axis=1).max()),
                  int(((n_hidden > MOST_HIDDEN * n_pixels) & ~marked).sum()),
                  int((excluded & ~has_touched_neighbour).sum()))
    append_result("start_runs", {"case": f"{name}, {options}", **vars(found)})
    return found

"""Whether the reference image shows something in the mesh that outweighs rounding."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.case.schema import Case
from ddic.errors import InputError
from ddic.images.binned import ArraySource
from ddic.images.grey_levels import find_saturation, measure_grey_levels
from ddic.images.source import ImageSource
from ddic.images.sub_image import MaskedSource
from ddic.images.window import Window
from ddic.io.image_file import hold_image
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_cell_size
from ddic.mesh.raster import rasterize
from ddic.problem.region_mesh import build_material
from ddic.problem.wavelength_limits import check_weight_fits

LARGEST_PROBE = 1000
"""Side of the part of the image whose texture is measured, pixels, in the middle of the mesh. A larger value takes
longer."""


def check_texture(case: Case, reference: ImageSource, mesh: Mesh) -> None:
    """Check that pixels of the mesh are left to measure by, and that the regularization does not drown them.

    Parameters
    ----------
    case : Case
        Says what is left out, and the regularization.
    reference : ImageSource
        The reference image.
    mesh : Mesh
        The whole mesh, inside the image.

    Raises
    ------
    InputError
        Where every pixel of the mesh is masked or saturated, where those that are left have one grey level, or where
        regularization.eta stands for a wavelength beyond what the mesh carries.
    """
    images = case.images
    window = _find_window(mesh, reference)
    if images.reference_mask is not None or images.exclude_saturated:
        usable = _find_usable(case, reference, mesh, window)
        if not usable.any():
            raise InputError("images.reference_mask, images.exclude_saturated: every pixel of the mesh is left out; "
                             "correct the mask (more than 0 where pixels are used), or images.saturation")
    else:
        usable = None
    _refuse_blank(reference, window, usable)
    section = case.regularization
    if section is not None and section.eta is not None:
        material = build_material(section)
        lame, shear = material.lame
        part = ArraySource(reference.path, reference.read(_shrink(window)), reference.saturation)
        texture = measure_grey_levels(part).gradient_energy
        check_weight_fits(section.eta, lame + 2 * shear, texture, measure_cell_size(mesh))


def _find_window(mesh: Mesh, reference: ImageSource) -> Window:
    """Pixels of the mesh's bounding box."""
    low, high = np.ceil(mesh.nodes.min(axis=0)).astype(int), np.floor(mesh.nodes.max(axis=0)).astype(int)
    return Window(int(low[0]), int(low[1]), int(high[0]) + 1, int(high[1]) + 1).clip(reference.width, reference.height)


def _find_usable(case: Case, reference: ImageSource, mesh: Mesh, window: Window) -> NDArray[np.bool_]:
    """Pixels of a window that lie in the mesh and count."""
    images = case.images
    saturated_from = None
    if images.exclude_saturated:
        saturated_from = find_saturation(reference) if images.saturation is None else images.saturation
    mask = None if images.reference_mask is None else hold_image(images.reference_mask)
    counted = MaskedSource(reference, mask, saturated_from).find_usable(window)
    covered = rasterize(mesh).find_covered(reference.width, reference.height)[window.y0:window.y1, window.x0:window.x1]
    return np.asarray(covered != 0 if counted is None else (covered & counted) != 0)


def _refuse_blank(reference: ImageSource, window: Window, usable: NDArray[np.bool_] | None) -> None:
    """Refuse a region of one grey level; read row by row only as far as there is one."""
    level = None
    for y in range(window.y0, window.y1):
        row = reference.read(Window(window.x0, y, window.x1, y + 1))[0]
        values = row if usable is None else row[usable[y - window.y0]]
        if values.size and level is None:
            level = values[0]
        if values.size and (values != level).any():
            return
    raise InputError(f"{reference.path}: the image shows one grey level, {level:g}, in the whole mesh: there is "
                     "nothing to measure by; place the mesh where there is texture")


def _shrink(window: Window) -> Window:
    """The middle of a window."""
    x0 = window.x0 + max(window.width - LARGEST_PROBE, 0) // 2
    y0 = window.y0 + max(window.height - LARGEST_PROBE, 0) // 2
    return Window(x0, y0, min(x0 + LARGEST_PROBE, window.x1), min(y0 + LARGEST_PROBE, window.y1))

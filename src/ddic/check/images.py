"""Whether an image pair and its masks can be measured on, and show texture that outweighs rounding."""

from pathlib import Path

import numpy as np

from ddic.arrays import BoolArray
from ddic.case.named_files import list_deformed
from ddic.case.schema import Case, ImagesSection, NearSection
from ddic.errors import InputError, Problems
from ddic.images.binned import ArraySource
from ddic.images.grey_levels import (
    MOST_LOOKED_AT,
    check_finite,
    check_noise,
    check_varied,
    find_saturation,
    list_spread_bands,
    measure_grey_levels,
    read_all,
)
from ddic.images.source import ImageSource
from ddic.images.sub_image import MaskedSource
from ddic.images.window import Window
from ddic.inputs.mesh_source import check_weight_fits
from ddic.io.image_file import ImageFile, hold_image, read_mask
from ddic.io.image_formats import can_decode, is_tiff, read_tiff_format
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_cell_size
from ddic.mesh.raster import rasterize
from ddic.problem.region_mesh import build_material

LEAST_SIDE = 8
"""Pixels along each side of an image, of which a spline and a few elements need some."""

LEAST_LEFT = 100
"""Pixels that masks have to leave, or half of a mesh of hardly more: a square of two speckles a side. With fewer, half
of all runs come to no field, for other places of the image match as well."""

LARGEST_PROBE = 1000
"""Side of the part of the image whose texture is measured, pixels, in the middle of the mesh. A larger value takes
longer."""


def check_images(images: ImagesSection | NearSection, problems: Problems) -> ImageSource | None:
    """Check the images of a camera and their masks; ``problems`` takes what is found.

    The reference image is returned, None where it cannot be read.
    """
    reference = _check_image(images.reference, images.reference_mask, problems)
    if reference is not None:
        with problems.gathered():
            check_varied(reference)
            if images.noise is not None:
                check_noise(reference, images.noise)
    deformed_images = list_deformed(images)
    # A blank frame of a series is told when its turn comes, and loses no other.
    is_pair = len(deformed_images) == 1
    for path in deformed_images:
        _check_other_image(path, images.deformed_mask, reference, problems, must_vary=is_pair)
    if isinstance(images, ImagesSection) and images.at_rest is not None:
        _check_other_image(images.at_rest, None, reference, problems, must_vary=True)
    return reference


def _check_other_image(path: Path, mask_path: Path | None, reference: ImageSource | None, problems: Problems, *,
                       must_vary: bool) -> None:
    """Check an image that is to be compared with the reference image."""
    image = _check_image(path, mask_path, problems)
    if image is None:
        return
    with problems.gathered():
        if must_vary:
            check_varied(image)
    with problems.gathered():
        if reference is not None:
            _check_same_size(reference, image)


def check_decodable(images: ImagesSection | NearSection, problems: Problems) -> None:
    """Check that the pixels of compressed images can be decoded, which takes as long as to read them.

    The images were found fit by ``check_images``; ``problems`` takes what is found.
    """
    for path in (images.reference, *list_deformed(images)):
        with problems.gathered():
            if not (is_tiff(path) and can_decode(path)):
                # Decoded whole when it was opened.
                continue
            layout = read_tiff_format(path)
            if layout.is_compressed:
                read_all(ImageFile(path, layout, windowed=True))


def _check_image(path: Path, mask_path: Path | None, problems: Problems) -> ImageSource | None:
    """An image, checked with its mask; None where it cannot be read."""
    source: ImageSource | None = None
    with problems.gathered():
        source = _hold_large_enough(path)
    if source is None:
        return None
    with problems.gathered():
        mask = None if mask_path is None else read_mask(mask_path, source.width, source.height)
        if mask is not None and _leaves_too_few(mask):
            raise InputError(f"{mask_path}: the mask leaves {np.count_nonzero(mask)} px of {path} to measure by; it "
                             "has to be more than 0 where pixels are to be used")
        check_finite(source, mask)
    return source


def _hold_large_enough(path: Path) -> ImageSource:
    """An image; InputError where it cannot be read, or has too few pixels."""
    source = hold_image(path)
    if min(source.width, source.height) < LEAST_SIDE:
        raise InputError(f"{path}: the image is {source.width}x{source.height} px: too small to measure on; give "
                         f"one of {LEAST_SIDE}x{LEAST_SIDE} px at least")
    return source


def _leaves_too_few(is_used: BoolArray) -> bool:
    """Whether next to nothing is left of an image, or of the box about a mesh."""
    return int(np.count_nonzero(is_used)) < min(LEAST_LEFT, is_used.size / 2)


def _check_same_size(reference: ImageSource, deformed: ImageSource) -> None:
    if (reference.width, reference.height) != (deformed.width, deformed.height):
        raise InputError(f"{deformed.path}: the image is {deformed.width}x{deformed.height} px, but the "
                         f"reference {reference.path} is {reference.width}x{reference.height} px; "
                         "give a pair of one size")


def check_texture(case: Case, reference: ImageSource, mesh: Mesh) -> None:
    """Check that pixels of the mesh are left to measure by, and that the regularization does not drown them.

    The mesh is inside the image. Raises InputError where next to every pixel of the mesh is masked or saturated, where
    those that are left have one grey level, or where regularization.eta stands for a wavelength beyond what the mesh
    carries.
    """
    images = case.images
    window = _find_window(mesh, reference)
    if images.reference_mask is not None or images.exclude_saturated:
        usable = _find_usable(case, reference, mesh, window)
        if _leaves_too_few(usable):
            raise InputError(f"images.reference_mask, images.exclude_saturated: {np.count_nonzero(usable)} px of the "
                             "mesh are left to measure by; correct the mask (more than 0 where pixels are used), or "
                             "images.saturation")
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


def _find_usable(case: Case, reference: ImageSource, mesh: Mesh, window: Window) -> BoolArray:
    """Pixels of a window that lie in the mesh and count."""
    images = case.images
    saturated_from = None
    if images.exclude_saturated:
        saturated_from = find_saturation(reference) if images.saturation is None else images.saturation
    mask = None if images.reference_mask is None else hold_image(images.reference_mask)
    counted = MaskedSource(reference, mask, saturated_from).find_usable(window)
    covered = rasterize(mesh).find_covered(reference.width, reference.height)[window.y0:window.y1, window.x0:window.x1]
    return np.asarray(covered != 0 if counted is None else (covered & counted) != 0)


def _refuse_blank(reference: ImageSource, window: Window, usable: BoolArray | None) -> None:
    """Refuse a region of one grey level; read only as far as there is one, and a large region in bands of it."""
    level = None
    for rows in list_spread_bands(window):
        band = reference.read(rows)
        values = band if usable is None else band[usable[rows.y0 - window.y0:rows.y1 - window.y0]]
        if values.size and level is None:
            level = values.flat[0]
        if values.size and (values != level).any():
            return
    where = "the whole mesh" if window.n_pixels <= MOST_LOOKED_AT else "all of the mesh that was looked at"
    raise InputError(f"{reference.path}: the image shows one grey level, {level:g}, in {where}: there is nothing to "
                     "measure by; place the mesh where there is texture")


def _shrink(window: Window) -> Window:
    """The middle of a window."""
    x0 = window.x0 + max(window.width - LARGEST_PROBE, 0) // 2
    y0 = window.y0 + max(window.height - LARGEST_PROBE, 0) // 2
    return Window(x0, y0, min(x0 + LARGEST_PROBE, window.x1), min(y0 + LARGEST_PROBE, window.y1))

"""Whether images and masks can be measured on, show texture, and, near ones, what their mapping says."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray
from ddic.case.named_files import list_deformed
from ddic.case.schema import CameraSection, Case, ImagingSection, Shape
from ddic.errors import InputError, Problems
from ddic.images.binned import ArraySource
from ddic.images.grey_levels import (
    MOST_LOOKED_AT,
    check_finite,
    check_noise,
    check_varied,
    count_used,
    list_spread_bands,
    measure_grey_levels,
    read_all,
)
from ddic.images.source import ImageSource
from ddic.images.window import Window
from ddic.inputs.cameras import Camera
from ddic.inputs.masks import draw_mask, exclude_from_reference
from ddic.inputs.mesh_source import check_weight_fits
from ddic.io.image_file import ImageFile
from ddic.io.image_formats import can_decode, is_tiff, read_tiff_format
from ddic.io.volume_file import VolumeFile, hold_source, open_mask
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from ddic.problem.region_mesh import build_material

LEAST_SIDE = 8
"""Pixels along each side of an image, of which a spline and a few elements need some."""

LEAST_LEFT = 100
"""Pixels that masks have to leave, or half of a mesh of hardly more: a square of two speckles a side. With fewer, half
of all runs come to no field, for other places of the image match as well."""

LARGEST_PROBES = {2: 1000, 3: 100}
"""Side of the part of the image whose texture is measured, pixels, in the middle of the mesh, by the number of
dimensions. A larger value takes longer."""

LEAST_COEFFICIENT = 0.3
"""Correlation of a near reference image with the far one below which it does not show what its mapping says: unrelated
images stay below 0.1, right ones are above 0.8, where the far image resolves what the near one shows. A larger value
refuses more."""

COARSEST_SPECKLE = 15
"""Far-field pixels over which the mean is taken off before images are compared. A larger value compares light and holes
rather than speckle."""

LARGEST_NEAR_PROBE = 1500
"""Side of the part of a near image that is compared, pixels. A larger value reads more of it."""

LEAST_HALF_PROBE = 4
"""Least half side of that part, far-field pixels, however much a near image magnifies."""


def check_images(images: CameraSection, name: str, problems: Problems) -> ImageSource | None:
    """Check a camera's images and masks, adding to ``problems``; returns the reference image, None if unreadable.

    ``name`` is what messages call the section, after its file.
    """
    reference = _check_image(images.reference, images.dim, images.reference_mask, problems, images.masked,
                             f"{name}.masked")
    if reference is not None:
        with problems.gathered():
            check_varied(reference)
            if images.noise is not None:
                check_noise(reference, images.noise)
    deformed_images = list_deformed(images)
    # A blank frame of a series is told when its turn comes, and loses no other.
    is_pair = len(deformed_images) == 1
    for path in deformed_images:
        _check_other_image(path, images.dim, images.deformed_mask, reference, problems, must_vary=is_pair)
    if isinstance(images, ImagingSection) and images.at_rest is not None:
        _check_other_image(images.at_rest, images.dim, None, reference, problems, must_vary=True)
    return reference


def _check_other_image(path: Path, dim: int, mask_path: Path | None, reference: ImageSource | None,
                       problems: Problems, *, must_vary: bool) -> None:
    """Check an image that is to be compared with the reference image."""
    image = _check_image(path, dim, mask_path, problems)
    if image is None:
        return
    with problems.gathered():
        if must_vary:
            check_varied(image)
    with problems.gathered():
        if reference is not None and reference.extent != image.extent:
            raise InputError(f"{image.path}: the image is {_say_size(image)} px, but the "
                             f"reference {reference.path} is {_say_size(reference)} px; "
                             "give a pair of one size")


def _say_size(image: ImageSource) -> str:
    return "x".join(map(str, image.extent.sizes))


def check_decodable(images: CameraSection, problems: Problems) -> None:
    """Check that the pixels of compressed images can be decoded, which takes as long as to read them.

    The images were found fit by ``check_images``; ``problems`` takes what is found.
    """
    for path in (images.reference, *list_deformed(images)):
        with problems.gathered():
            if images.dim == 3:
                volume = hold_source(path, images.dim)
                if isinstance(volume, VolumeFile) and volume.is_compressed:
                    read_all(volume)
                continue
            if not (is_tiff(path) and can_decode(path)):
                # Decoded whole when it was opened.
                continue
            layout = read_tiff_format(path)
            if layout.is_compressed:
                read_all(ImageFile(path, layout, windowed=True))


def _check_image(path: Path, dim: int, mask_path: Path | None, problems: Problems, shapes: Sequence[Shape] = (),
                 name: str = "") -> ImageSource | None:
    """An image, checked with its mask, and shapes, of a key of that name; None where it cannot be read."""
    source: ImageSource | None = None
    with problems.gathered():
        source = _hold_large_enough(path, dim)
    if source is None:
        return None
    with problems.gathered():
        below = None if mask_path is None else open_mask(mask_path, source.extent)
        mask = draw_mask(shapes, source.extent, name, below)
        n_used = source.extent.n_pixels if mask is None else count_used(mask)
        if _is_too_few(n_used, source.extent.n_pixels):
            remedy = "draw smaller shapes" if shapes else "it has to be more than 0 where pixels are to be used"
            raise InputError(f"{name if shapes else mask_path}: the mask leaves {n_used} px of {path} to measure by; "
                             f"{remedy}")
        check_finite(source, mask)
    return source


def _hold_large_enough(path: Path, dim: int) -> ImageSource:
    """An image; InputError where it cannot be read, or has too few pixels."""
    source = hold_source(path, dim)
    if min(source.extent.sizes) < LEAST_SIDE:
        raise InputError(f"{path}: the image is {_say_size(source)} px: too small to measure on; give "
                         f"one of {'x'.join([str(LEAST_SIDE)] * dim)} px at least")
    return source


def _is_too_few(n_used: int, n_pixels: int) -> bool:
    """Whether next to nothing is left of an image, or of the box about a mesh."""
    return n_used < min(LEAST_LEFT, n_pixels / 2)


def check_texture(case: Case, reference: ImageSource, mesh: Mesh, cell_size: float) -> None:
    """Check that pixels of the mesh are left to measure by, and that the regularization does not drown them.

    The mesh, or one of the same region, is inside the image; ``cell_size`` is that of its cells, pixels. Raises
    InputError where next to every pixel of the mesh is masked or saturated, where those that are left have one grey
    level, or where regularization.eta stands for a wavelength beyond what the mesh carries.
    """
    images = case.imaging
    window = _bound(mesh.nodes).intersection(reference.extent)
    if images.reference_mask is not None or images.masked or images.exclude_saturated:
        find_usable = _prepare_usable(case, reference, mesh)
        n_usable = sum(int(np.count_nonzero(find_usable(band))) for band in _split(window))
        if _is_too_few(n_usable, window.n_pixels):
            keys, drawn = ("volumes.mask", "") if case.dim == 3 else (
                "images.reference_mask, images.masked, images.exclude_saturated", ", the shapes, or images.saturation")
            raise InputError(f"{keys}: {n_usable} px of the mesh are left to measure by; correct the mask (more than 0 "
                             f"where pixels are used){drawn}")
    else:
        find_usable = None
    _refuse_blank(reference, window, find_usable)
    section = case.regularization
    if section is not None and section.eta is not None:
        c11, c22, *_ = build_material(section, case.dim).moduli
        part = ArraySource(reference.path, reference.read(_shrink(window)), reference.saturation)
        texture = measure_grey_levels(part).gradient_energy
        check_weight_fits(section.eta, max(c11, c22), texture, cell_size, case.dim)


def _bound(points: Array) -> Window:
    """Pixels in the box about some points."""
    low, high = np.ceil(points.min(axis=0)).astype(int), np.floor(points.max(axis=0)).astype(int)
    return Window.between(low, high + 1)


BAND_PIXELS = 1 << 25
"""Pixels of which is told at a time which ones count; a larger value takes more memory."""


def _split(window: Window) -> Iterator[Window]:
    return window.split_rows(max(1, BAND_PIXELS * window.sizes[-1] // max(window.n_pixels, 1)))


def _prepare_usable(case: Case, reference: ImageSource, mesh: Mesh) -> Callable[[Window], BoolArray]:
    """A function that tells which pixels of a window lie in the mesh and count."""
    masked = exclude_from_reference(reference, case.imaging, lambda path: hold_source(path, case.dim))
    raster, cells = rasterize(mesh), np.arange(mesh.n_cells)

    def find_usable(window: Window) -> BoolArray:
        counted, covered = masked.find_usable(window), raster.draw_cells(cells, window)
        return np.asarray(covered != 0 if counted is None else (covered & counted) != 0)

    return find_usable


def _refuse_blank(reference: ImageSource, window: Window, find_usable: Callable[[Window], BoolArray] | None) -> None:
    """Refuse a region of one grey level; read only as far as there is one, and a large region in bands of it."""
    level = None
    for rows in list_spread_bands(window):
        band = reference.read(rows)
        values = band if find_usable is None else band[find_usable(rows)]
        if values.size and level is None:
            level = values.flat[0]
        if values.size and (values != level).any():
            return
    where = "the whole mesh" if window.n_pixels <= MOST_LOOKED_AT else "all of the mesh that was looked at"
    raise InputError(f"{reference.path}: the image shows one grey level, {level:g}, in {where}: there is nothing to "
                     "measure by; place the mesh where there is texture")


def _shrink(window: Window) -> Window:
    """The middle of a window."""
    side = LARGEST_PROBES[len(window.sizes)]
    lower = window.lower + np.maximum(np.array(window.sizes) - side, 0) // 2
    return Window.between(lower, np.minimum(lower + side, window.upper))


def check_near_mapping(far: Camera, near: Camera) -> None:
    """Check that a near camera's reference image shows what the far one shows there.

    Raises InputError where the mapping puts the near image outside the far one, mirrors it, or puts it in a wrong
    place.
    """
    far_path = far.reference.image.path
    place = f"{near.entry}: {near.reference.image.path}"
    seen = _bound(near.setup.mapping.to_specimen(near.reference.extent.corners))
    common = seen.intersection(far.reference.extent)
    if common.width < 2 or common.height < 2:
        raise InputError(f"{place} lies outside the far-field image {far_path} by its mapping (columns {seen.x0} "
                         f"to {seen.x1 - 1}, rows {seen.y0} to {seen.y1 - 1}); find the mapping with ddic calibrate")
    if _measure_area_ratio(near) <= 0:
        raise InputError(f"{place}: its mapping turns the image over; mirror the images, or correct the mapping")
    coefficient = _correlate_references(far, near, common)
    if coefficient < LEAST_COEFFICIENT:
        raise InputError(f"{place} does not show what the far-field image {far_path} shows where its mapping "
                         f"puts it (correlation coefficient {coefficient:.2f}); find the mapping with ddic calibrate")


def _measure_area_ratio(near: Camera) -> float:
    """Area of a far pixel in the middle of the near image, near pixels; negative where the mapping mirrors."""
    return float(np.linalg.det(near.setup.mapping.jacobian(near.setup.centre[None])[0]))


def _correlate_references(far: Camera, near: Camera, common: Window) -> float:
    """Correlation coefficient of the reference images at far pixels near the middle of a window."""
    # Near pixels a far pixel, along a side.
    magnification = float(np.sqrt(_measure_area_ratio(near)))
    window = _choose_probe(near.setup.centre, magnification, common)
    seen = near.setup.mapping.to_image(_list_pixels(window))
    near_values, is_inside = _sample_blurred(near.reference.image, seen, magnification)
    far_values = np.asarray(far.reference.image.read(window), dtype=np.float32)
    near_speckle = _speckle(near_values.reshape(far_values.shape)).ravel()[is_inside]
    far_speckle = _speckle(far_values).ravel()[is_inside]
    if len(near_speckle) < 2 or near_speckle.std() == 0 or far_speckle.std() == 0:
        return 0.0
    return float(np.corrcoef(near_speckle, far_speckle)[0, 1])


def _choose_probe(centre: Array, magnification: float, common: Window) -> Window:
    """The part of a window that is compared: around the middle of the near image, far-field pixels."""
    half = max(int(LARGEST_NEAR_PROBE / magnification / 2), LEAST_HALF_PROBE)
    x = int(np.clip(round(centre[0]), common.x0, common.x1 - 1))
    y = int(np.clip(round(centre[1]), common.y0, common.y1 - 1))
    return Window((x - half, y - half), (x + half, y + half)).intersection(common)


def _list_pixels(window: Window) -> Array:
    """Positions of all pixels of a window, row after row, (n, 2)."""
    rows, columns = np.mgrid[window.y0:window.y1, window.x0:window.x1]
    return np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64)


def _sample_blurred(image: ImageSource, points: Array, magnification: float) -> tuple[NDArray[np.float32], BoolArray]:
    """An image averaged over far pixels, at the pixels nearest to some points, (n,), and whether each lies in it."""
    low = np.floor(points.min(axis=0)).astype(int) - 1
    high = np.ceil(points.max(axis=0)).astype(int) + 2
    part = Window.between(low, high).intersection(image.extent)
    side = max(round(magnification), 1)
    values = cv2.blur(np.asarray(image.read(part), dtype=np.float32), (side, side))
    first_pixel = (part.x0, part.y0)
    last_pixel = (part.x1 - 1, part.y1 - 1)
    is_inside = ((points >= first_pixel) & (points <= last_pixel)).all(axis=1)
    last_place = (part.width - 1, part.height - 1)
    nearest = np.rint(np.clip(points - first_pixel, 0, last_place)).astype(int)
    return np.asarray(values[nearest[:, 1], nearest[:, 0]]), is_inside


def _speckle(image: NDArray[np.float32]) -> Array:
    """An image without what is wider than speckle: light and holes are alike in wrong places too."""
    return np.asarray(image - cv2.blur(image, (COARSEST_SPECKLE, COARSEST_SPECKLE)), dtype=np.float64)

"""Whether an image pair and its masks can be measured on."""

from __future__ import annotations

from pathlib import Path

from ddic.case.frame_files import list_deformed
from ddic.case.schema import ImagesSection, NearSection
from ddic.errors import InputError
from ddic.images.grey_levels import check_finite, check_noise, check_varied, read_all
from ddic.images.source import ImageSource
from ddic.io.image_file import ImageFile, hold_image
from ddic.io.mask_file import read_mask
from ddic.io.tiff_file import can_decode, is_tiff, read_tiff_format
from ddic.problem.gather_problems import Problems

LEAST_SIDE = 8
"""Pixels along each side of an image, of which a spline and a few elements need some."""


def check_images(images: ImagesSection | NearSection, problems: Problems) -> ImageSource | None:
    """Check the images of a camera and their masks.

    Parameters
    ----------
    images : ImagesSection or NearSection
        Names the files.
    problems : Problems
        Takes what is found.

    Returns
    -------
    ImageSource or None
        The reference image; None where it cannot be read.
    """
    reference = _check_image(images.reference, images.reference_mask, problems)
    if reference is not None:
        with problems.gathered():
            check_varied(reference)
            if images.noise is not None:
                check_noise(reference, images.noise)
    deformed_images = list_deformed(images)
    for path in deformed_images:
        deformed = _check_image(path, images.deformed_mask, problems)
        if deformed is not None and len(deformed_images) == 1:
            # A blank frame of a series is told when its turn comes, and loses no other.
            with problems.gathered():
                check_varied(deformed)
        if reference is not None and deformed is not None:
            with problems.gathered():
                _check_same_size(reference, deformed)
    if isinstance(images, ImagesSection) and images.at_rest is not None:
        at_rest = _check_image(images.at_rest, None, problems)
        if reference is not None and at_rest is not None:
            with problems.gathered():
                check_varied(at_rest)
                _check_same_size(reference, at_rest)
    return reference


def check_decodable(images: ImagesSection | NearSection, problems: Problems) -> None:
    """Check that the pixels of compressed images can be decoded, which takes as long as to read them.

    Parameters
    ----------
    images : ImagesSection or NearSection
        Names the files; found fit by ``check_images``.
    problems : Problems
        Takes what is found.
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
        if mask is not None and not mask.any():
            raise InputError(f"{mask_path}: the mask is 0 everywhere, so that no pixel of {path} is used; it has to be "
                             "more than 0 where pixels are to be used")
        check_finite(source, mask)
    return source


def _hold_large_enough(path: Path) -> ImageSource:
    """An image; InputError where it cannot be read, or has too few pixels."""
    source = hold_image(path)
    if min(source.width, source.height) < LEAST_SIDE:
        raise InputError(f"{path}: the image is {source.width}x{source.height} px: too small to measure on; give "
                         f"one of {LEAST_SIDE}x{LEAST_SIDE} px at least")
    return source


def _check_same_size(reference: ImageSource, deformed: ImageSource) -> None:
    if (reference.width, reference.height) != (deformed.width, deformed.height):
        raise InputError(f"{deformed.path}: the image is {deformed.width}x{deformed.height} px, but the "
                         f"reference {reference.path} is {reference.width}x{reference.height} px; "
                         "give a pair of one size")

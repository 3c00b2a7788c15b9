"""Whether an image pair and its masks can be measured on."""

from __future__ import annotations

from pathlib import Path

from ddic.case.frame_files import list_deformed
from ddic.case.schema import ImagesSection, NearSection
from ddic.errors import InputError
from ddic.images.grey_levels import check_finite
from ddic.images.source import ImageSource
from ddic.io.image_file import open_image
from ddic.io.mask_file import read_mask
from ddic.problem.gather_problems import Problems


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
    for path in list_deformed(images):
        deformed = _check_image(path, images.deformed_mask, problems)
        if reference is not None and deformed is not None:
            with problems.gathered():
                _check_same_size(reference, deformed)
    if isinstance(images, ImagesSection) and images.at_rest is not None:
        at_rest = _check_image(images.at_rest, None, problems)
        if reference is not None and at_rest is not None:
            with problems.gathered():
                _check_same_size(reference, at_rest)
    return reference


def _check_image(path: Path, mask_path: Path | None, problems: Problems) -> ImageSource | None:
    """An image, checked with its mask; None where it cannot be read."""
    source: ImageSource | None = None
    with problems.gathered():
        source = open_image(path)
    if source is None:
        return None
    with problems.gathered():
        mask = None if mask_path is None else read_mask(mask_path, source.width, source.height)
        check_finite(source, mask)
    return source


def _check_same_size(reference: ImageSource, deformed: ImageSource) -> None:
    if (reference.width, reference.height) != (deformed.width, deformed.height):
        raise InputError(f"{deformed.path}: the image is {deformed.width}x{deformed.height} px, but the "
                         f"reference {reference.path} is {reference.width}x{reference.height} px; "
                         "give a pair of one size")

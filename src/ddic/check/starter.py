"""A case file to start from: images named, region and elements from the pattern, what else is often wanted told."""

import json
import os
from collections.abc import Sequence
from pathlib import Path

from ddic.check.pattern import Pattern

WAVELENGTHS = 5
"""Elements of the cut-off wavelength that is named."""

MOST_BARE = 0.05
"""Share of the region without texture from which on the case has mechanics bridge it."""

SMALLEST_FEATURE = 3.0
"""Width of the features, pixels, below which pixels sample them badly, so that elements by themselves are noisy."""

UNNAMED = '"DEFORMED.tif"    # the image after loading: name it, or a pattern of several such as "frame_*.tif"'

TEXT = """\
# Written by ddic new. Look at the mesh with  ddic check {name} --plot mesh.png,  measure with  ddic run {name}.
# Every key: docs/case-file.md. Coordinates are pixels of the reference image: x = column, y = row, from its upper left.

[images]
reference = {reference}
deformed = {deformed}

[mesh.structured]
region = {region}    # x0, y0, x1, y1: where the reference image bears a pattern
element_size = {element}    # px: {why}
# circles = [{{ center = [{x}, {y}], radius = {element} }}]    # holes; polygons and masks: docs/case-file.md
# {mechanics}: mechanics bridge what pixels do not tell.
{off}[regularization]
{off}cut_off_wavelength = {wavelength}    # px: waves that are shorter are damped; ddic sweep recommends one
# not_controlled = ["left", "right", "top", "bottom"]    # edges at which the specimen goes on or is clamped

[output]
file = "{stem}.vtkhdf"    # ParaView and Python read it; ddic plot draws it
# uncertainty = true    # standard deviations of displacement and strain at every node
"""


def write_starter_case(path: Path, reference: Path, deformed: Sequence[Path], pattern: Pattern,
                       region: tuple[int, int, int, int]) -> str:
    """Write the text of a case file at a path, from which images are named, of a pair or of a series."""
    images = [_name_image(image, path.parent) for image in deformed] or [UNNAMED]
    listed = images[0] if len(images) == 1 else "[\n    " + ",\n    ".join(images) + ",\n]"
    element = pattern.choose_element_size()
    bare = pattern.measure_bare_share(region)
    is_sparse = bare > MOST_BARE or pattern.feature_size < SMALLEST_FEATURE
    mechanics = "Where noise is too strong, or elements are to be smaller"
    if is_sparse:
        mechanics = (f"{bare:.0%} of the region has hardly any texture" if bare > MOST_BARE else
                     "The pattern is finer than pixels show well")
    x0, y0, x1, y1 = region
    return TEXT.format(name=path.name, stem=path.stem, reference=_name_image(reference, path.parent), deformed=listed,
                       region=list(region), element=element, x=(x0 + x1) // 2, y=(y0 + y1) // 2,
                       mechanics=mechanics, off="" if is_sparse else "# ",
                       why=pattern.describe_elements(element), wavelength=WAVELENGTHS * element)


def _name_image(image: Path, folder: Path) -> str:
    """A path as a TOML text: from the folder of the case where the image is in it or beside it."""
    whole = image.absolute()
    from_folder = os.path.relpath(whole, folder.absolute())
    is_near = not from_folder.startswith(os.path.join(os.pardir, os.pardir))
    return json.dumps(from_folder if is_near else str(whole), ensure_ascii=False)

"""``ddic calibrate``: where a near-field image lies in a far-field one."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ddic.cli.failures import failures_as_lines, warnings_as_lines

if TYPE_CHECKING:
    from ddic.calibration.near import Calibration
    from ddic.calibration.registration import Kind

Lines = list[tuple[str, str]]


@click.command("calibrate")
@click.argument("far", metavar="FAR", type=click.Path(path_type=Path))
@click.argument("near", metavar="NEAR", type=click.Path(path_type=Path))
@click.option("--ratio", type=float, required=True, help="Near px per far px, right within 15 %.")
@click.option("--model", type=click.Choice(["translation", "similarity", "homography"]), default="homography",
              help="What is solved for; a translation keeps the ratio as given.")
@click.option("--distortion", is_flag=True, help="Also solve for the near camera's radial distortion k1.")
@click.option("--output", type=click.Path(dir_okay=False, path_type=Path),
              help="Mapping file for near.mapping_file of a case.")
def calibrate_near(far: Path, near: Path, ratio: float, model: Kind, distortion: bool, output: Path | None) -> None:
    """Find the mapping from the far to the near reference image of one specimen, and its uncertainty.

    The near field must lie in the far image, turned by 5 degrees at most.
    """
    # Imported here because they bring numba, SciPy and OpenCV, which --help does not need.
    import numpy as np

    from ddic.calibration.near import calibrate_near_camera
    from ddic.case.own_outputs import MAPPING, require_own_output
    from ddic.images.grey_levels import check_finite
    from ddic.io.mapping_file import MappingFile, write_mapping
    from ddic.io.volume_file import hold_source

    with failures_as_lines(output):
        if output is not None:
            require_own_output(output, MAPPING, (far, near))
        with warnings_as_lines():
            images = [hold_source(path, 2) for path in (far, near)]
            for image in images:
                check_finite(image)
            found = calibrate_near_camera(images[0], images[1], ratio, model, distortion)
        if output is not None:
            write_mapping(output, MappingFile(found.mapping, found.far_size, found.near_size, found.homography_std,
                                              np.array([found.k1_std, 0.0]), float(found.places_std.max()),
                                              found.registration.coefficient))
    for name, value in _lines(found):
        click.echo(f"{name:<20}{value}")
    if output is not None:
        click.echo(f"{'mapping file':<20}{output}")


def _lines(found: Calibration) -> Lines:
    """Names and values of what is printed."""
    ratio, rotation, x, y = found.similarity_std
    registration = found.registration
    names = ("top left", "top right", "bottom left", "bottom right", "centre")
    lines = [
        ("ratio", f"{_pm(found.ratio, ratio)} near px per far px"),
        ("rotation", f"{_pm(found.rotation, rotation)} degrees"),
        ("offset", f"{_pm(found.offset[0], x)}, {_pm(found.offset[1], y)} near px, where far pixel (0, 0) would be"),
        ("not a similarity", f"{found.deviation[0]:.4f} near px RMS, {found.deviation[1]:.4f} at most"),
    ]
    if registration.model.distorts:
        lines.append(("distortion k1", f"{_pm(float(found.mapping.radial[0]), found.k1_std)} at a radius of "
                                       f"{found.mapping.radius:.1f} near px"))
    lines += [(f"near {name}", f"far ({place[0]:.4f}, {place[1]:.4f}) px, +- {std[0]:.1e}, {std[1]:.1e} near px")
              for name, place, std in zip(names, found.places_far, found.places_std, strict=True)]
    return [
        *lines,
        ("grey levels", f"far = {registration.gain:.4f} near + {registration.offset:.3f}"),
        ("correlation", f"coefficient {registration.coefficient:.4f}, {registration.n_pixels} far pixels compared"),
        ("residual", f"{registration.residual_std:.3f} grey levels; neighbours' correlation changes the variance by a "
                     f"factor of {registration.correlation:.2f}"),
    ]


def _pm(value: float, std: float) -> str:
    """A value and its standard deviation, with digits down to the latter's second one."""
    digits = min(max(1 - math.floor(math.log10(std)), 0), 9) if std > 1e-9 else 6
    return f"{value:.{digits}f} +- {std:.{digits}f}"

"""``ddic synth``: image pairs whose displacement is known exactly."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

import click

from ddic.cli.synth_near_far import near_far
from ddic.cli.synth_options import ImageOptions, add_image_options, write_images

if TYPE_CHECKING:
    from ddic.synth.fields import DisplacementField, Hole

Pair = tuple[float, float]
_pair_options = add_image_options("512x512", "reference.tif, deformed.tif and truth.json")


@click.group()
def synth() -> None:
    """Generate speckled image pairs with an exactly known displacement.

    Pixels: x is the column, y the row (downwards), pixel centres are at integers.
    """


synth.add_command(near_far)


@synth.command()
@click.option("--vector", type=float, nargs=2, default=(0.25, -0.4), show_default=True, help="u_x u_y, px.")
@_pair_options
def translation(vector: Pair, **image: Unpack[ImageOptions]) -> None:
    """Move the whole image by one vector."""
    from ddic.synth.fields import Translation

    _generate(Translation(vector), None, image)


@synth.command()
@click.option("--gradient", type=float, nargs=4, default=(0.01, 0.0, 0.0, -0.003), show_default=True,
              help="du_x/dx du_x/dy du_y/dx du_y/dy.")
@click.option("--vector", type=float, nargs=2, default=(0.0, 0.0), show_default=True,
              help="Displacement of the centre, px.")
@click.option("--center", type=float, nargs=2, default=None, help="x y, px.  [default: the image's centre]")
@_pair_options
def affine(gradient: tuple[float, float, float, float], vector: Pair, center: Pair | None,
           **image: Unpack[ImageOptions]) -> None:
    """Deform with a uniform gradient."""
    from ddic.synth.fields import Affine

    matrix = (gradient[:2], gradient[2:])
    _generate(Affine(matrix, vector, center or _middle(image)), None, image)


@synth.command()
@click.option("--offset", type=float, nargs=2, default=(0.35, -0.25), show_default=True,
              help="Mean of u_x and of u_y, px.")
@click.option("--amplitude", type=float, nargs=2, default=(0.60, 0.50), show_default=True,
              help="Of u_x and of u_y, px.")
@click.option("--wavelength-x", type=float, nargs=2, default=(1024.0, 1280.0), show_default=True,
              help="Of u_x along x and along y, px.")
@click.option("--wavelength-y", type=float, nargs=2, default=(1280.0, 1024.0), show_default=True,
              help="Of u_y along x and along y, px.")
@click.option("--phase-x", type=float, nargs=2, default=(0.3, -0.2), show_default=True,
              help="Of u_x along x and along y, rad.")
@click.option("--phase-y", type=float, nargs=2, default=(-0.7, 0.5), show_default=True,
              help="Of u_y along x and along y, rad.")
@_pair_options
def sinusoidal(offset: Pair, amplitude: Pair, wavelength_x: Pair, wavelength_y: Pair, phase_x: Pair,
               phase_y: Pair, **image: Unpack[ImageOptions]) -> None:
    """Deform with waves; the default values are the reference field of all accuracy figures."""
    from ddic.synth.fields import Sinusoidal

    _generate(Sinusoidal(offset, amplitude, wavelength_x, wavelength_y, phase_x, phase_y), None, image)


@synth.command()
@click.option("--center", type=float, nargs=2, default=None,
              help="Of the hole, x y, px.  [default: the image's centre]")
@click.option("--radius", type=float, default=None,
              help="Of the hole, px.  [default: a tenth of the shorter side]")
@click.option("--strain", type=float, default=0.005, show_default=True,
              help="Far-field stress over Young's modulus.")
@click.option("--poisson-ratio", type=float, default=0.3, show_default=True)
@click.option("--translation", type=float, nargs=2, default=(0.0, 0.0), show_default=True,
              help="Rigid displacement added, px.")
@click.option("--paint-hole/--no-paint-hole", "draw_hole", default=True, show_default=True,
              help="Show the hole as a dark disc, or leave speckles in it.")
@_pair_options
def kirsch(center: Pair | None, radius: float | None, strain: float, poisson_ratio: float,
           translation: Pair, draw_hole: bool, **image: Unpack[ImageOptions]) -> None:
    """Pull a plate with a circular hole along y (Kirsch's solution)."""
    from ddic.synth.fields import Hole, Kirsch

    center = center or _middle(image)
    radius = min(image["size"]) / 10 if radius is None else radius
    field = Kirsch(center, radius, strain, poisson_ratio, translation)
    _generate(field, Hole(center, radius) if draw_hole else None, image)


@synth.command()
@click.option("--curvature", type=float, default=1e-5, show_default=True, help="Of the neutral axis, 1/px.")
@click.option("--center", type=float, nargs=2, default=None, help="x y, px.  [default: the image's centre]")
@click.option("--poisson-ratio", type=float, default=0.3, show_default=True)
@click.option("--translation", type=float, nargs=2, default=(0.0, 0.0), show_default=True,
              help="Rigid displacement added, px.")
@_pair_options
def bending(curvature: float, center: Pair | None, poisson_ratio: float, translation: Pair,
            **image: Unpack[ImageOptions]) -> None:
    """Bend a beam along x as between the inner rollers of a four-point test."""
    from ddic.synth.fields import Bending, Sum, Translation

    beam = Bending(curvature, center or _middle(image), poisson_ratio)
    _generate(Sum((beam, Translation(translation))), None, image)


def _middle(image: ImageOptions) -> Pair:
    """Position of the image's centre, pixels."""
    width, height = image["size"]
    return (width - 1) / 2, (height - 1) / 2


def _generate(field: DisplacementField, hole: Hole | None, image: ImageOptions) -> None:
    """Write the two images and the truth."""
    from ddic.synth.render import Digitiser, Picture, Scene, write_pair
    from ddic.synth.speckle import SpeckleTexture
    from ddic.synth.truth import describe_pair

    width, height = image["size"]
    digitiser = Digitiser(int(image["bit_depth"]), image["noise"], image["seed"])
    picture = Picture(width, height, digitiser)
    texture = SpeckleTexture(image["seed"], image["speckle_size"])
    scene = Scene(texture, field, hole)
    folder = image["output"]
    pair = folder / "reference.tif", folder / "deformed.tif"
    write_images(folder, [path.name for path in pair], describe_pair(scene, picture),
                 lambda files: write_pair(pair, scene, picture, files=files))

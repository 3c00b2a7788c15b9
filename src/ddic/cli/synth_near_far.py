"""``ddic synth near-far``: two image pairs of one specimen at different magnifications."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

import click

from ddic.cli.synth_options import ImageOptions, Size, add_image_options, parse_size, write_images

if TYPE_CHECKING:
    from ddic.synth.near_far_scene import NearFarScene
    from ddic.synth.render import Picture

Pair = tuple[float, float]
_FILES = "far_reference.tif, far_deformed.tif, near_reference.tif, near_deformed.tif and truth.json"


@click.command("near-far")
@click.option("--ratio", type=float, default=5.0, show_default=True, help="Near pixels per far pixel.")
@click.option("--near-center", type=float, nargs=2, default=None,
              help="Of the near field, x y, far px.  [default: beside the hole, its right edge inside]")
@click.option("--near-angle", type=float, default=0.0, show_default=True,
              help="Of the near picture against the far one, from x towards y, degrees.")
@click.option("--tilt", type=float, nargs=2, default=(0.0, 0.0), show_default=True,
              help="Of the near camera: how much farther, as a fraction, the specimen is at the near field's right "
                   "and lower edge than at its centre.")
@click.option("--alpha", type=float, nargs=2, default=(3.7, -2.2), show_default=True,
              help="Translation of the near set-up between its two pictures, far px.")
@click.option("--rotation", type=float, default=0.0, show_default=True,
              help="Rotation of the near set-up between its two pictures, about the near field's centre, degrees.")
@click.option("--center", type=float, nargs=2, default=None,
              help="Of the hole, x y, far px.  [default: the far image's centre]")
@click.option("--radius", type=float, default=None,
              help="Of the hole, far px.  [default: a tenth of the far image's shorter side]")
@click.option("--strain", type=float, default=0.005, show_default=True, help="Far-field stress over Young's modulus.")
@click.option("--poisson-ratio", type=float, default=0.3, show_default=True)
@click.option("--translation", type=float, nargs=2, default=(0.0, 0.0), show_default=True,
              help="Rigid displacement of the specimen, far px.")
@click.option("--size-far", callback=parse_size, metavar="WIDTHxHEIGHT", help="Of the far images.  [default: --size]")
@click.option("--size-near", callback=parse_size, metavar="WIDTHxHEIGHT",
              help="Of the near images.  [default: --size]")
@click.option("--noise-far", type=float, default=None, help="Of the far images, grey levels.  [default: --noise]")
@click.option("--noise-near", type=float, default=None, help="Of the near images, grey levels.  [default: --noise]")
@click.option("--fine-share", type=float, default=0.4, show_default=True,
              help="Of the fine speckles in the near images' contrast, 0 to 1.")
@add_image_options("1392x1040", _FILES)
def near_far(ratio: float, near_center: Pair | None, near_angle: float, tilt: Pair, alpha: Pair, rotation: float,
             center: Pair | None, radius: float | None, strain: float, poisson_ratio: float, translation: Pair,
             size_far: Size | None, size_near: Size | None, noise_far: float | None, noise_near: float | None,
             fine_share: float, **image: Unpack[ImageOptions]) -> None:
    """Pull a plate with a circular hole along y before two cameras of different magnification.

    The far images show coarse speckles of about 5 far px; the near ones the same and fine ones of about 5 near px.
    The specimen's frame is the far reference image.
    """
    from ddic.synth.fields import Hole, Kirsch
    from ddic.synth.near_far_scene import (
        NearCamera,
        SetUpMotion,
        build_near_far_scene,
        build_near_mapping,
        place_beside_hole,
    )
    from ddic.synth.speckle import two_scale_texture

    far = _picture(image, size_far, noise_far)
    near = _picture(image, size_near, noise_near)
    center = center or far.middle
    radius = min(far.width, far.height) / 10 if radius is None else radius
    field = Kirsch(center, radius, strain, poisson_ratio, translation)
    focus = near_center or place_beside_hole(center, radius, ratio, near)
    mapping = build_near_mapping(ratio, focus, near, near_angle, tilt)
    camera = NearCamera(mapping, SetUpMotion(alpha, rotation, focus), near)
    texture = two_scale_texture(ratio, image["seed"], image["speckle_size"], fine_share)
    _write(image, build_near_far_scene(texture, field, Hole(center, radius), far, camera))


def _picture(image: ImageOptions, size: Size | None, noise: float | None) -> Picture:
    """A camera's picture; size, noise: its own, or None for those of both cameras."""
    from ddic.synth.render import Digitiser, Picture

    width, height = size or image["size"]
    level = image["noise"] if noise is None else noise
    digitiser = Digitiser(int(image["bit_depth"]), level, image["seed"])
    return Picture(width, height, digitiser)


def _write(image: ImageOptions, scene: NearFarScene) -> None:
    """Write the images and the truth."""
    from ddic.synth.near_far_scene import FAR_FILES, NEAR_FILES, write_near_far
    from ddic.synth.truth import describe_near_far

    folder = image["output"]
    write_images(folder, [*FAR_FILES, *NEAR_FILES], describe_near_far(scene),
                 lambda files: write_near_far(folder, scene, files))

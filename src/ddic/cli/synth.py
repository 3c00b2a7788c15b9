"""``ddic synth``: pairs of images or volumes whose displacement is known exactly, also pairs at two magnifications."""

from __future__ import annotations

import copy
import json
import os
import re
import stat
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar, Unpack

import click

from ddic.errors import InputError, WriteError, is_disk_failure

if TYPE_CHECKING:
    from ddic.io.replace_on_exit import NewFiles
    from ddic.synth.fields import DisplacementField, Hole
    from ddic.synth.render import Picture


Command = TypeVar("Command", bound=Callable[..., Any])
Size = tuple[int, ...]
Vector = tuple[float, ...]


class _ImageOptions(TypedDict):
    """The options that every kind of field shares."""

    size: Size
    bit_depth: str
    noise: float
    seed: int
    speckle_size: float
    output: Path


class _Vector(click.Option):
    """An option of several numbers: of a volume ``n_of_volume`` of them, by default those of ``of_volume``."""

    def __init__(self, names: Sequence[str], n_of_volume: int = 3, of_volume: Vector | None = None,
                 **settings: Any) -> None:
        super().__init__(names, type=float, **settings)
        self.of_volume = {"nargs": n_of_volume} if of_volume is None else {"nargs": n_of_volume, "default": of_volume}

    def for_volume(self) -> _Vector:
        """Give the option as a volume has it."""
        option = copy.copy(self)
        vars(option).update(self.of_volume)
        return option


class _AnyDimension(click.Command):
    """A command that makes images or volumes: --size says which, before the numbers of vectors are counted."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the words of a command."""
        sizes = re.findall(r"(?:^|\0)--size[=\0]([^\0]*)", "\0".join(args))
        ctx.meta[__name__] = "".join(sizes[-1:]).lower().count("x") == 2
        return super().parse_args(ctx, args)

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """List the options, as a volume has them where --size is one's."""
        params = super().get_params(ctx)
        is_volume = ctx.meta.get(__name__)
        return [param.for_volume() if is_volume and isinstance(param, _Vector) else param for param in params]


def _parse_size(context: click.Context, _option: click.Parameter, text: str | None) -> Size | None:
    """Turn "640x480" into (640, 480), pixels, and None into None; raises BadParameter where it is no such text."""
    from ddic.io.image_formats import MOST_PIXELS_ALONG

    if text is None:
        return None
    sizes = re.findall(r"[1-9]\d*", text)
    if re.fullmatch(r"[1-9]\d*([xX][1-9]\d*){1,2}", text) is None:
        raise click.BadParameter(f"{text!r} is not WIDTHxHEIGHT in pixels, for instance 640x480")
    if len(sizes) == 3 and not isinstance(context.command, _AnyDimension):
        raise click.BadParameter(f"{text} is a volume, and {context.command.name} plane: give WIDTHxHEIGHT")
    # Not int() first: Python takes no more than 4300 digits.
    if max(map(len, sizes)) > len(str(MOST_PIXELS_ALONG)) or max(map(int, sizes)) > MOST_PIXELS_ALONG:
        raise click.BadParameter(f"images have {MOST_PIXELS_ALONG} columns and rows at most")
    return tuple(map(int, sizes))


_PLANE_SIZE = ("WIDTHxHEIGHT", "Size, pixels.")
_ANY_SIZE = ("WIDTHxHEIGHT[xDEPTH]", "Size, pixels; with a depth of volumes, whose vectors have a third number: "
             "--size 64x64x64 --help shows them.")


def _add_image_options(size: str, files: str, shown: tuple[str, str] = _PLANE_SIZE) -> Callable[[Command], Command]:
    """Make a decorator that adds _ImageOptions: default and help of --size, and what --output will hold."""
    options = (
        click.option("--size", callback=_parse_size, default=size, metavar=shown[0], help=shown[1]),
        click.option("--bit-depth", type=click.Choice(["8", "16", "32"]), default="8",
                     help="8 or 16 bit, or 32 for float values on the scale 0..255."),
        click.option("--noise", type=float, default=0.0,
                     help="Standard deviation of the noise of all images, 8-bit grey levels."),
        click.option("--seed", type=int, default=0, help="Seed of speckle and noise."),
        click.option("--speckle-size", type=float, default=1.0,
                     help="Magnification of the speckle; 1 has spots of about 5 px."),
        click.option("--output", type=click.Path(file_okay=False, path_type=Path), required=True,
                     help=f"Folder for {files}."),
    )

    def add(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def write_images(folder: Path, names: Sequence[str], record: dict[str, Any],
                 render: Callable[[NewFiles], object]) -> None:
    """Write images and their truth, all or nothing, and say where they are.

    Images that are there already are replaced only where a command like this one made them and no case file beside them
    or in the folder above names them, or by the same ones. The folder is made where it is not there; ``record`` is the
    content of truth.json; ``render`` begins the images in the files that it is given, and writes them.

    Raises InputError where other files have these names, or the folder cannot be made or written to; WriteError where
    the disk does not take the files.
    """
    from ddic.io.replace_on_exit import made_folder, replaced_together
    from ddic.io.text_files import write_json

    truth = folder / "truth.json"
    paths = [*(folder / name for name in names), truth]
    try:
        _require_free(paths, record)
        with made_folder(folder), replaced_together() as files:
            render(files)
            write_json(truth, record, files)
    except OSError as error:
        if is_disk_failure(error):
            raise WriteError(f"{error.filename or folder}: cannot be written to ({error.strerror}); nothing was "
                             "written; make room, or choose another --output") from error
        raise InputError(f"--output {folder}: {error.strerror}; choose a writable folder") from error
    for path in paths:
        click.echo(path)


def _require_free(paths: Sequence[Path], record: dict[str, Any]) -> None:
    """Raise InputError where a file is there, unless all are of an earlier command like this one, and no case's."""
    from ddic.case.own_outputs import require_no_input
    from ddic.io.text_files import convert_to_json

    taken = [path for path in paths if os.path.lexists(path)]
    if not taken:
        return
    is_set = len(taken) == len(paths) and all(map(_is_plain, taken))
    # A device may have no end.
    before = _read_truth(paths[-1]) if is_set else {}
    if before == json.loads(json.dumps(convert_to_json(record))):
        # The same images again.
        return
    for path in paths:
        require_no_input(path)
    if before.get("format") != record["format"] or ("near" in before) != ("near" in record):
        raise InputError(f"{taken[0]}: is there already, and not of a whole set that ddic synth made; remove it, or "
                         "choose another --output")


def _is_plain(path: Path) -> bool:
    """Whether a file has one name and is no link."""
    status = path.lstat()
    return stat.S_ISREG(status.st_mode) and status.st_nlink == 1


def _read_truth(path: Path) -> dict[str, Any]:
    """What a truth file holds; nothing where it is none."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


Pair = tuple[float, float]
_FILES = "far_reference.tif, far_deformed.tif, near_reference.tif, near_deformed.tif and truth.json"


@click.command("near-far")
@click.option("--ratio", type=float, default=5.0, help="Near pixels per far pixel.")
@click.option("--near-center", type=float, nargs=2,
              help="Of the near field, x y, far px.  [default: beside the hole, its right edge inside]")
@click.option("--near-angle", type=float, default=0.0,
              help="Of the near picture against the far one, from x towards y, degrees.")
@click.option("--tilt", type=float, nargs=2, default=(0.0, 0.0),
              help="Of the near camera: how much farther, as a fraction, the specimen is at the near field's right and "
                   "lower edge than at its centre.")
@click.option("--alpha", type=float, nargs=2, default=(3.7, -2.2),
              help="Translation of the near set-up between its two pictures, far px.")
@click.option("--rotation", type=float, default=0.0,
              help="Rotation of the near set-up between its two pictures, about the near field's centre, degrees.")
@click.option("--center", type=float, nargs=2, help="Of the hole, x y, far px.  [default: the far image's centre]")
@click.option("--radius", type=float, help="Of the hole, far px.  [default: a tenth of the far image's shorter side]")
@click.option("--strain", type=float, default=0.005, help="Far-field stress over Young's modulus.")
@click.option("--poisson-ratio", type=float, default=0.3)
@click.option("--translation", type=float, nargs=2, default=(0.0, 0.0),
              help="Rigid displacement of the specimen, far px.")
@click.option("--size-far", callback=_parse_size, metavar="WIDTHxHEIGHT", help="Of the far images.  [default: --size]")
@click.option("--size-near", callback=_parse_size, metavar="WIDTHxHEIGHT",
              help="Of the near images.  [default: --size]")
@click.option("--noise-far", type=float, help="Of the far images, grey levels.  [default: --noise]")
@click.option("--noise-near", type=float, help="Of the near images, grey levels.  [default: --noise]")
@click.option("--fine-share", type=float, default=0.4,
              help="Of the fine speckles in the near images' contrast, 0 to 1.")
@_add_image_options("1392x1040", _FILES)
def near_far(ratio: float, near_center: Pair | None, near_angle: float, tilt: Pair, alpha: Pair, rotation: float,
             center: Pair | None, radius: float | None, strain: float, poisson_ratio: float, translation: Pair,
             size_far: Size | None, size_near: Size | None, noise_far: float | None, noise_near: float | None,
             fine_share: float, **image: Unpack[_ImageOptions]) -> None:
    """Pull a plate with a circular hole along y before two cameras of different magnification.

    The far images show coarse speckles of about 5 far px; the near ones the same and fine ones of about 5 near px.
    The specimen's frame is the far reference image.
    """
    from ddic.synth import near_far_scene
    from ddic.synth.fields import Hole, Kirsch
    from ddic.synth.speckle import two_scale_texture
    from ddic.synth.truth import describe_near_far

    far = _picture(image, size_far, noise_far)
    near = _picture(image, size_near, noise_near)
    x, y = far.middle
    center = center or (x, y)
    radius = min(far.width, far.height) / 10 if radius is None else radius
    field = Kirsch(center, radius, strain, poisson_ratio, translation)
    focus = near_center or near_far_scene.place_beside_hole(center, radius, ratio, near)
    mapping = near_far_scene.build_near_mapping(ratio, focus, near, near_angle, tilt)
    motion = near_far_scene.SetUpMotion(alpha, rotation, focus)
    camera = near_far_scene.NearCamera(mapping, motion, near)
    texture = two_scale_texture(ratio, image["seed"], image["speckle_size"], fine_share)
    scene = near_far_scene.build_near_far_scene(texture, field, Hole(center, radius), far, camera)
    folder = image["output"]
    write_images(folder, [*near_far_scene.FAR_FILES, *near_far_scene.NEAR_FILES], describe_near_far(scene),
                 lambda files: near_far_scene.write_near_far(folder, scene, files))


def _picture(image: _ImageOptions, size: Size | None = None, noise: float | None = None) -> Picture:
    """A camera's picture; one of two cameras may have a size and noise of its own."""
    from ddic.synth.render import Digitiser, Picture

    width, height, *depth = size or image["size"]
    level = image["noise"] if noise is None else noise
    digitiser = Digitiser(int(image["bit_depth"]), level, image["seed"])
    return Picture(width, height, digitiser, *depth)


_FILES_OF_PAIR = "reference.tif, deformed.tif and truth.json"
_plane_options = _add_image_options("512x512", _FILES_OF_PAIR)
_pair_options = _add_image_options("512x512", _FILES_OF_PAIR, _ANY_SIZE)


@click.group()
def synth() -> None:
    """Generate speckled image pairs with an exactly known displacement.

    Pixels: x is the column, y the row (downwards), pixel centres are at integers.

    Pairs of volumes are made by translation, affine and sinusoidal with --size WIDTHxHEIGHTxDEPTH; z is the page.
    """


synth.add_command(near_far)


@synth.command(cls=_AnyDimension)
@click.option("--vector", cls=_Vector, nargs=2, default=(0.25, -0.4), of_volume=(0.25, -0.4, 0.3),
              help="u_x u_y [u_z], px.")
@_pair_options
def translation(vector: Vector, **image: Unpack[_ImageOptions]) -> None:
    """Move the whole image by one vector."""
    from ddic.synth.fields import Translation

    _generate(Translation(vector), None, image)


@synth.command(cls=_AnyDimension)
@click.option("--gradient", cls=_Vector, nargs=4, default=(0.01, 0.0, 0.0, -0.003), n_of_volume=9,
              of_volume=(0.01, 0.0, 0.0, 0.0, -0.003, 0.0, 0.0, 0.0, -0.003),
              help="du_x/dx du_x/dy du_y/dx du_y/dy, of volumes row by row too.")
@click.option("--vector", cls=_Vector, nargs=2, default=(0.0, 0.0), of_volume=(0.0, 0.0, 0.0),
              help="Displacement of the centre, px.")
@click.option("--center", cls=_Vector, nargs=2, help="x y [z], px.  [default: the image's centre]")
@_pair_options
def affine(gradient: Vector, vector: Vector, center: Vector | None, **image: Unpack[_ImageOptions]) -> None:
    """Deform with a uniform gradient."""
    from ddic.synth.fields import Affine

    n_axes = len(vector)
    matrix = tuple(gradient[first : first + n_axes] for first in range(0, len(gradient), n_axes))
    _generate(Affine(matrix, vector, center or _picture(image).middle), None, image)


@synth.command(cls=_AnyDimension)
@click.option("--offset", cls=_Vector, nargs=2, default=(0.35, -0.25), of_volume=(0.35, -0.25, 0.15),
              help="Mean of u_x, of u_y [and of u_z], px.")
@click.option("--amplitude", cls=_Vector, nargs=2, default=(0.60, 0.50), of_volume=(0.60, 0.50, 0.55),
              help="Of u_x, of u_y [and of u_z], px.")
@click.option("--wavelength-x", cls=_Vector, nargs=2, default=(1024.0, 1280.0), of_volume=(1024.0, 1280.0, 1150.0),
              help="Of u_x along x, along y [and along z], px.")
@click.option("--wavelength-y", cls=_Vector, nargs=2, default=(1280.0, 1024.0), of_volume=(1280.0, 1024.0, 1100.0),
              help="Of u_y, likewise, px.")
@click.option("--wavelength-z", cls=_Vector, nargs=3, of_volume=(1100.0, 1200.0, 1024.0),
              help="Of u_z, likewise, px; of volumes alone.")
@click.option("--phase-x", cls=_Vector, nargs=2, default=(0.3, -0.2), of_volume=(0.3, -0.2, 0.1),
              help="Of u_x along x, along y [and along z], rad.")
@click.option("--phase-y", cls=_Vector, nargs=2, default=(-0.7, 0.5), of_volume=(-0.7, 0.5, -0.4),
              help="Of u_y, likewise, rad.")
@click.option("--phase-z", cls=_Vector, nargs=3, of_volume=(0.2, -0.3, 0.6),
              help="Of u_z, likewise, rad; of volumes alone.")
@_pair_options
def sinusoidal(offset: Vector, amplitude: Vector, wavelength_x: Vector, wavelength_y: Vector,
               wavelength_z: Vector | None, phase_x: Vector, phase_y: Vector, phase_z: Vector | None,
               **image: Unpack[_ImageOptions]) -> None:
    """Deform with waves; the default values are the reference field of all accuracy figures."""
    from ddic.synth.fields import Sinusoidal

    _generate(Sinusoidal(offset, amplitude, wavelength_x, wavelength_y, phase_x, phase_y, wavelength_z, phase_z),
              None, image)


@synth.command()
@click.option("--center", type=float, nargs=2, help="Of the hole, x y, px.  [default: the image's centre]")
@click.option("--radius", type=float, help="Of the hole, px.  [default: a tenth of the shorter side]")
@click.option("--strain", type=float, default=0.005, help="Far-field stress over Young's modulus.")
@click.option("--poisson-ratio", type=float, default=0.3)
@click.option("--translation", type=float, nargs=2, default=(0.0, 0.0), help="Rigid displacement added, px.")
@click.option("--paint-hole/--no-paint-hole", "draw_hole", default=True,
              help="Show the hole as a dark disc, or leave speckles in it.")
@_plane_options
def kirsch(center: Pair | None, radius: float | None, strain: float, poisson_ratio: float,
           translation: Pair, draw_hole: bool, **image: Unpack[_ImageOptions]) -> None:
    """Pull a plate with a circular hole along y (Kirsch's solution)."""
    from ddic.synth.fields import Hole, Kirsch

    x, y = _picture(image).middle
    center = center or (x, y)
    radius = min(image["size"]) / 10 if radius is None else radius
    field = Kirsch(center, radius, strain, poisson_ratio, translation)
    _generate(field, Hole(center, radius) if draw_hole else None, image)


@synth.command()
@click.option("--curvature", type=float, default=1e-5, help="Of the neutral axis, 1/px.")
@click.option("--center", type=float, nargs=2, help="x y, px.  [default: the image's centre]")
@click.option("--poisson-ratio", type=float, default=0.3)
@click.option("--translation", type=float, nargs=2, default=(0.0, 0.0), help="Rigid displacement added, px.")
@_plane_options
def bending(curvature: float, center: Pair | None, poisson_ratio: float, translation: Pair,
            **image: Unpack[_ImageOptions]) -> None:
    """Bend a beam along x as between the inner rollers of a four-point test."""
    from ddic.synth.fields import Bending, Sum, Translation

    x, y = _picture(image).middle
    beam = Bending(curvature, center or (x, y), poisson_ratio)
    _generate(Sum((beam, Translation(translation))), None, image)


def _generate(field: DisplacementField, hole: Hole | None, image: _ImageOptions) -> None:
    """Write the two images and the truth."""
    from ddic.synth.render import Scene, write_pair
    from ddic.synth.speckle import SpeckleTexture
    from ddic.synth.truth import describe_pair

    picture = _picture(image)
    texture = SpeckleTexture(image["seed"], image["speckle_size"])
    scene = Scene(texture, field, hole)
    folder = image["output"]
    pair = folder / "reference.tif", folder / "deformed.tif"
    write_images(folder, [path.name for path in pair], describe_pair(scene, picture),
                 lambda files: write_pair(pair, scene, picture, files=files))

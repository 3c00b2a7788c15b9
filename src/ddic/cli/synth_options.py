"""Options and helpers that the commands of ``ddic synth`` share."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypedDict, TypeVar

import click

from ddic.errors import InputError

Command = TypeVar("Command", bound=Callable[..., Any])
Size = tuple[int, int]


class ImageOptions(TypedDict):
    """The options that every kind of field shares."""

    size: Size
    bit_depth: str
    noise: float
    seed: int
    speckle_size: float
    output: Path


def parse_size(_context: click.Context, _option: click.Parameter, text: str | None) -> Size | None:
    """Turn "640x480" into (640, 480); None stays None.

    Parameters
    ----------
    _context : Context
        Of click.
    _option : Parameter
        Of click.
    text : str or None
        WIDTHxHEIGHT.

    Returns
    -------
    (int, int) or None
        Pixels.

    Raises
    ------
    BadParameter
        Where it is no such text.
    """
    if text is None:
        return None
    match = re.fullmatch(r"([1-9]\d*)[xX]([1-9]\d*)", text)
    if match is None:
        raise click.BadParameter(f"{text!r} is not WIDTHxHEIGHT in pixels, for instance 640x480")
    return int(match[1]), int(match[2])


def add_image_options(size: str, files: str) -> Callable[[Command], Command]:
    """Make a decorator that adds the options of ImageOptions.

    Parameters
    ----------
    size : str
        Default of --size.
    files : str
        What --output will hold.

    Returns
    -------
    callable
        The decorator.
    """
    options = (
        click.option("--size", callback=parse_size, default=size, show_default=True,
                     metavar="WIDTHxHEIGHT", help="Size, pixels."),
        click.option("--bit-depth", type=click.Choice(["8", "16", "32"]), default="8", show_default=True,
                     help="8 or 16 bit, or 32 for float values on the scale 0..255."),
        click.option("--noise", type=float, default=0.0, show_default=True,
                     help="Standard deviation of the noise of all images, 8-bit grey levels."),
        click.option("--seed", type=int, default=0, show_default=True, help="Seed of speckle and noise."),
        click.option("--speckle-size", type=float, default=1.0, show_default=True,
                     help="Magnification of the speckle; 1 has spots of about 5 px."),
        click.option("--output", type=click.Path(file_okay=False, path_type=Path), required=True,
                     help=f"Folder for {files}."),
    )

    def add(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def prepare_folder(folder: Path, truth: Path) -> None:
    """Make the folder and drop the truth of earlier images, which no longer holds.

    Parameters
    ----------
    folder : Path
        Of the images.
    truth : Path
        Of the truth file.

    Raises
    ------
    InputError
        Where the folder cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        truth.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"--output {folder}: {error.strerror}; choose a writable folder") from error

"""Options and helpers that the commands of ``ddic synth`` share."""

from __future__ import annotations

import json
import os
import re
import stat
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar

import click

from ddic.errors import InputError, WriteError, is_disk_failure
from ddic.io.image_formats import MOST_PIXELS_ALONG

if TYPE_CHECKING:
    from ddic.io.replace_on_exit import NewFiles

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
    # Not int() first: Python takes no more than 4300 digits.
    if max(map(len, match.groups())) > len(str(MOST_PIXELS_ALONG)) or max(map(int, match.groups())) > MOST_PIXELS_ALONG:
        raise click.BadParameter(f"images have {MOST_PIXELS_ALONG} columns and rows at most")
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


def write_images(folder: Path, names: Sequence[str], record: dict[str, Any],
                 render: Callable[[NewFiles], object]) -> None:
    """Write images and their truth, all or nothing, and say where they are.

    Images that are there already are replaced only where a command like this one made them and no case file beside
    them or in the folder above names them, or by the same ones.

    Parameters
    ----------
    folder : Path
        Made where it is not there.
    names : sequence of str
        Of the images.
    record : dict
        Content of truth.json.
    render : callable
        Begins the images in the files that it is given, and writes them.

    Raises
    ------
    InputError
        Where other files have these names, or the folder cannot be made or written to.
    WriteError
        Where the disk does not take the files.
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
    is_set = before.get("format") == record["format"]
    if is_set and before == json.loads(json.dumps(convert_to_json(record))):
        # The same images again.
        return
    for path in paths:
        require_no_input(path)
    if not is_set or ("near" in before) != ("near" in record):
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

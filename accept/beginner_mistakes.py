"""Mistakes that everybody makes in a first case, and what ``ddic check`` says of each before anything runs.

A mistake is told where a problem, a warning or a line of the report names what is wrong and what to do about it.
"""

from __future__ import annotations

import json
import shutil
import warnings
from dataclasses import dataclass
from pathlib import Path

import cv2
import meshio
import numpy as np
import tifffile

from accept.spoilt_images import draw_clean
from accept.table import Scale
from bench.support.rows import Row
from ddic.check.case import check_case_file
from ddic.errors import InputError

SIDE = 256
"""Of the images, pixels."""

GOOD = """[images]
reference = "ref.tif"
deformed = "def.tif"
[mesh.structured]
region = [32, 32, 224, 208]
element_size = 16
[output]
file = "out.vtkhdf"
"""


@dataclass(frozen=True)
class Mistake:
    """A mistake.

    Attributes
    ----------
    name : str
        What was done.
    text : str or bytes
        The case.
    told : tuple of str
        What has to stand in one line of what is said.
    """

    name: str
    text: str | bytes
    told: tuple[str, ...]


def _change(old: str, new: str) -> str:
    if old not in GOOD:
        raise ValueError(f"{old} is not in the case")
    return GOOD.replace(old, new)


def list_mistakes() -> list[Mistake]:
    """List the mistakes, each with what tells it."""
    region, element = "region = [32, 32, 224, 208]", "element_size = 16"
    images = 'deformed = "def.tif"\n'
    return [
        Mistake("backslashes in a path", _change('"ref.tif"', '"C:\\data\\ref.tif"'), ("backslash", "with /")),
        Mistake("a decimal comma", _change(element, "element_size = 16,5"), ("decimal point",)),
        Mistake("a word without quotes", _change('"ref.tif"', "ref.tif"), ("not valid TOML", "line 2")),
        Mistake("a number in quotes", _change(element, 'element_size = "16"'), ("element_size", "expected a number")),
        Mistake("a misspelt key", _change("element_size", "elment_size"), ("did you mean", "element_size")),
        Mistake("a key in another section", _change(images, images + "element_size = 16\n"),
                ("images.element_size", "it belongs to|valid here")),
        Mistake("a missing image", _change("def.tif", "def_1.tif"), ("def_1.tif", "check the path")),
        Mistake("a folder in place of an image", _change("def.tif", "folder"), ("folder",)),
        Mistake("images of two sizes", _change("def.tif", "small.tif"), ("small.tif", "px")),
        Mistake("the same image twice", _change("def.tif", "ref.tif"), ("images.deformed", "reference")),
        Mistake("a JPEG", _change("def.tif", "def.jpg"), ("JPEG compression", "TIFF or PNG")),
        Mistake("a colour image", _change("def.tif", "colour.png"), ("turned to grey",)),
        Mistake("a pattern that fits no file", _change("def.tif", "frame_*.tif"), ("frame_*.tif",)),
        Mistake("the reference in the pattern of its series", _change("def.tif", "?ef.tif"),
                ("reference image itself", "narrow")),
        Mistake("corners in the other order", _change(region, "region = [224, 208, 32, 32]"), ("region", "x0, y0")),
        Mistake("width and height in place of a corner", _change(region, "region = [128, 128, 192, 176]"),
                ("mesh", "cells")),
        Mistake("rows and columns swapped", GOOD.replace('"ref', '"wide_ref').replace('"def', '"wide_def').replace(
            region, "region = [32, 160, 96, 480]"), ("region|outside|lies", "image")),
        Mistake("a region on black background", GOOD.replace('"ref', '"dark_ref').replace('"def', '"dark_def').replace(
            region, "region = [8, 8, 248, 248]"), ("hardly any texture", "move the region|mask")),
        Mistake("elements larger than the region", _change(element, "element_size = 500"),
                ("at least one element",)),
        Mistake("elements of a speckle or less", _change(element, "element_size = 3"), ("px are suggested",)),
        Mistake("a hole outside the region",
                _change(element, element + "\ncircles = [{ center = [700, 40], radius = 9 }]"),
                ("hole_0", "outside the region")),
        Mistake("a mask of another size", _change(element, element + '\nmask = "small.tif"'), ("small.tif", "size")),
        Mistake("a mask the wrong way round", _change(element, element + '\nmask = "nothing.tif"'),
                ("mask",)),
        Mistake("an unknown node set", GOOD + '[regularization]\ncut_off_wavelength = 64\nnot_controlled = ["upper"]\n',
                ("upper", "left", "boxes")),
        Mistake("both eta and a wavelength", GOOD + "[regularization]\ncut_off_wavelength = 64\neta = 10\n",
                ("either", "cut_off_wavelength")),
        Mistake("regularization without a weight", GOOD + "[regularization]\n", ("cut_off_wavelength", "eta")),
        Mistake("a wavelength shorter than the elements", GOOD + "[regularization]\ncut_off_wavelength = 3\n",
                ("cut_off_wavelength",)),
        Mistake("a pixel size without its unit", _change(images, images + "pixel_size = 0.02\n"), ("length_unit",)),
        Mistake("an unknown method", GOOD + '[solver]\nmethod = "mumps"\n', ("method", "assembled")),
        Mistake("an output folder that is not there", _change("out.vtkhdf", "results/out.vtkhdf"), ("results",)),
        Mistake("the result over an image", _change("out.vtkhdf", "def.tif"), ("def.tif",)),
        Mistake("a mesh in millimetres",
                _change(f"[mesh.structured]\n{region}\n{element}", '[mesh]\nfile = "mm.msh"'), ("mapping|pixel",)),
        Mistake("a line beside the mesh", GOOD + "[[discontinuity]]\nvertices = [[300, 300], [400, 400]]\n",
                ("discontinuity",)),
        Mistake("a section twice", GOOD + "[output]\nuncertainty = true\n", ("not valid TOML", "line")),
        Mistake("UTF-16 of a text editor", GOOD.encode("utf-16"), ("UTF-8",)),
    ]


def measure_mistakes(scale: Scale) -> list[Row]:
    """Count the mistakes that are told."""
    folder = scale.folder("mistakes")
    shutil.rmtree(folder, ignore_errors=True)
    _write_images(folder)
    mistakes = list_mistakes()
    silent = []
    for mistake in mistakes[:: 6 if scale.smoke else 1]:
        said = _check(folder, mistake)
        if not any(all(_holds(line, words) for words in mistake.told) for line in said):
            silent.append(f"{mistake.name} ({'; '.join(said)[:160]})")
    (folder / "said.json").write_text(json.dumps(silent, indent=1))
    return [Row(f"{len(mistakes)} beginner's mistakes, ddic check", "all told with the remedy, or warned of",
                f"{len(mistakes) - len(silent)} told" + (f"; not: {'; '.join(silent)}" if silent else ""), not silent)]


def _holds(line: str, words: str) -> bool:
    return any(word in line for word in words.split("|"))


def _check(folder: Path, mistake: Mistake) -> list[str]:
    """All that is said of a case, line by line."""
    path = folder / "case.toml"
    path.write_bytes(mistake.text if isinstance(mistake.text, bytes) else mistake.text.encode())
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            lines = [f"{name} {value}" for name, value in check_case_file(path).list_lines()]
        except InputError as error:
            lines = list(error.problems)
    return [*lines, *(str(warning.message) for warning in caught)]


def _write_images(folder: Path) -> None:
    """Write the images, masks and the mesh that the cases name."""
    folder.mkdir(parents=True)
    (folder / "folder").mkdir()
    pair = draw_clean()
    reference, deformed = pair.reference[:SIDE, :SIDE], pair.deformed[:SIDE, :SIDE]
    for name, image in (("ref", reference), ("def", deformed)):
        tifffile.imwrite(folder / f"{name}.tif", image)
        tifffile.imwrite(folder / f"wide_{name}.tif", image[:128])
        dark = np.full_like(image, 4)
        dark[96:160] = image[96:160]
        tifffile.imwrite(folder / f"dark_{name}.tif", dark)
    tifffile.imwrite(folder / "small.tif", deformed[:100, :100])
    tifffile.imwrite(folder / "nothing.tif", np.zeros_like(reference))
    cv2.imwrite(str(folder / "def.jpg"), deformed)
    cv2.imwrite(str(folder / "colour.png"), np.dstack([deformed, deformed // 2, deformed]))
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    meshio.write(folder / "mm.msh", meshio.Mesh(points, [("quad", np.array([[0, 1, 2, 3]]))]), file_format="gmsh")

"""Frames of a smooth motion that grows, with the images' files and a case."""

from __future__ import annotations

import json
import shutil
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from accept.support.deformed_pair import Camera, Deformation, render_deformed
from bench.support.runs import source_version

Array = NDArray[np.float64]

NOISE = 1.0
"""Standard deviation of the images' noise, grey levels."""

REPEATABLE = '[solver]\nmethod = "dual"\n'
"""Settings of two runs that are compared bit by bit. Left open, small cases on several ranks are given to MUMPS, which
adds up what ranks send in the order in which it comes: its last bits differ between any two runs."""


@dataclass(frozen=True)
class Frames:
    """A series of frames.

    Attributes
    ----------
    size : (width, height)
        Pixels.
    n_frames : int
        Deformed images.
    largest : float
        Displacement in the last one, pixels.
    """

    size: tuple[int, int]
    n_frames: int
    largest: float

    def make_deformation(self, number: int) -> Deformation:
        """Make the deformation of a frame.

        Parameters
        ----------
        number : int
            From 0, the reference.

        Returns
        -------
        Deformation
            Bending and stretching, in proportion to the number.
        """
        share = self.largest * number / self.n_frames
        centre = np.array(self.size) / 2

        def displacement(points: Array) -> Array:
            x, y = ((points - centre) / centre).T
            along, across = 0.7 * np.sin(1.4 * x) + 0.2 * np.cos(2 * y), 0.5 * y * np.cos(x)
            return np.asarray(share * np.stack([along, across], axis=1))

        return Deformation(displacement)


def write_frames(frames: Frames, folder: Path) -> None:
    """Write the images that are not there already: reference.tif and frame_1.tif, frame_2.tif, ...

    Parameters
    ----------
    frames : Frames
        Which.
    folder : Path
        Where; made where it is not there.
    """
    stamp = folder / "frames.json"
    wanted = json.dumps([asdict(frames), source_version()])
    if not stamp.is_file() or stamp.read_text(encoding="utf-8") != wanted:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        stamp.write_text(wanted, encoding="utf-8")
    missing = [number for number in range(frames.n_frames + 1) if not _name(folder, number).is_file()]
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        list(pool.map(partial(_write_frame, frames, folder), missing))


def _name(folder: Path, number: int) -> Path:
    return folder / (f"frame_{number}.tif" if number else "reference.tif")


def _write_frame(frames: Frames, folder: Path, number: int) -> None:
    reference, deformed = render_deformed(frames.make_deformation(number), Camera(frames.size, NOISE))
    path = _name(folder, number)
    unfinished = path.with_suffix(".unfinished")
    tifffile.imwrite(unfinished, deformed if number else reference)
    unfinished.rename(path)


def describe_case(frames: Frames, element: float) -> str:
    """Give the case of a series.

    Parameters
    ----------
    frames : Frames
        Of the images.
    element : float
        Side of the elements, pixels.

    Returns
    -------
    str
        TOML text without ``[output]``.
    """
    margin = 2 * element
    region = [margin, margin, frames.size[0] - margin, frames.size[1] - margin]
    return f"""
[images]
reference = "reference.tif"
deformed = "frame_*.tif"
[mesh.structured]
region = {region}
element_size = {element}
"""

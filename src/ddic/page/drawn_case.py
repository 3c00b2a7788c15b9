"""The case that a page draws on: how it begins, what its text comes to, and its file, which alone is written."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from threading import Lock

import cv2
import numpy as np

from ddic.arrays import Array, IntArray
from ddic.case.loader import LoadedCase, load_text_leniently
from ddic.case.schema import Case, MeshSection
from ddic.check.case import CheckReport, build_checked_mesh, check_case, describe_pattern
from ddic.check.pattern import Pattern, choose_region, find_pattern
from ddic.check.starter import write_starter_case
from ddic.errors import InputError
from ddic.inputs.mesh_source import build_mesh_anywhere, build_plain_grid, is_plain_grid
from ddic.io.input_file import find_real_path
from ddic.io.replace_on_exit import remove_abandoned, replaced_on_exit
from ddic.io.text_files import read_text
from ddic.io.volume_file import hold_source, read_mask
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import count_cells
from ddic.mesh.topology import find_boundary_facets
from ddic.page.case_run import CaseRun
from ddic.page.image_pane import ScreenImage

MOST_CELLS = 300_000
"""Of a mesh that is built as a whole, some 300 MB; more of them take memory and seconds after every change."""

BYTES_OF_CELL = 50
"""Of a mesh file, with the cell's share of the nodes: the least of usual formats."""


@dataclass(frozen=True, eq=False)
class DrawnCase:
    """What a page of ``ddic draw`` draws on, the same for all tabs.

    Attributes
    ----------
    path : Path
        The case file, alone written to.
    text : str
        To begin with where there is no file.
    image : ScreenImage
        The reference image.
    pattern : Pattern
        It bears.
    run : CaseRun
        Of the case.
    """

    path: Path
    text: str
    image: ScreenImage
    pattern: Pattern
    run: CaseRun


@dataclass(frozen=True, eq=False)
class Checked:
    """What the text of a case comes to.

    Attributes
    ----------
    loaded : LoadedCase or None
        As far as it can be read.
    mesh : Mesh, GridLines or None
        As far as there is one; of a rectangle of equal cells its lines.
    report : CheckReport or None
        Where nothing is wrong.
    problems : sequence of str
        One line each.
    warnings : sequence of str
        What may not be meant, one line each.
    """

    loaded: LoadedCase | None
    mesh: Mesh | GridLines | None
    report: CheckReport | None
    problems: Sequence[str]
    warnings: Sequence[str] = ()

    @cached_property
    def outline(self) -> IntArray:
        """Nodes of the edges at the boundary of the mesh, (n_edges, 2); of a million cells a second's work."""
        return find_boundary_facets(self.mesh)[:, :2] if isinstance(self.mesh, Mesh) else np.zeros((0, 2), np.int64)


ONE_CHECK = Lock()
"""Warnings are gathered, and gmsh is used, by one thread of a process at a time."""


def check_text(text: str, drawn: DrawnCase) -> Checked:
    """Check the text of a case as ``ddic check`` checks its file; its mesh comes also where something else is wrong."""
    with ONE_CHECK, warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", UserWarning)
        checked = _check_text(text, drawn)
    lines = [str(warning.message) for warning in warned if issubclass(warning.category, UserWarning)]
    return replace(checked, warnings=list(dict.fromkeys(lines)))


def _check_text(text: str, drawn: DrawnCase) -> Checked:
    loaded, problems = load_text_leniently(text, drawn.path)
    if loaded is None:
        return Checked(None, None, None, problems)
    try:
        n_cells = estimate_cells(loaded.case)
    except InputError as error:
        return Checked(loaded, None, None, [*problems, *error.problems])
    if n_cells > MOST_CELLS:
        warnings.warn(f"{loaded.case.mesh.name}: about {n_cells:,} elements; this page builds meshes of up to "
                      f"{MOST_CELLS:,}, and of more only rectangles without holes: it draws outlines alone, and "
                      f"ddic check {drawn.path} says the rest", UserWarning, stacklevel=2)
        return Checked(loaded, None, None, problems)
    image = drawn.image.source
    if not _is_drawn_on(loaded, image.path):
        problems = [*problems, f"images.reference: this page shows {image.path}; draw another image by ddic draw"]
    try:
        report = check_case(loaded, None, problems)
        mesh = build_checked_mesh(loaded, image)
        return Checked(loaded, mesh, describe_pattern(report, loaded, mesh, drawn.pattern), [])
    except InputError as error:
        problems = list(error.problems)
    try:
        build = build_plain_grid if is_plain_grid(loaded.case) else build_mesh_anywhere
        return Checked(loaded, build(loaded.case), None, problems)
    except InputError:
        return Checked(loaded, None, None, problems)


def estimate_cells(case: Case) -> int:
    """Estimate the cells of the meshes that would be built as a whole for a case, from above where they have holes.

    Raises InputError where no mesh has as many.
    """
    if is_plain_grid(case):
        return 0
    return sum(_estimate_cells(mesh) for mesh in (case.mesh, *(near.mesh for near in case.near)) if mesh is not None)


def _estimate_cells(mesh: MeshSection) -> int:
    section = mesh.meshed
    if section is not None:
        n_columns, n_rows = count_cells(section.box, section.element_size, mesh.name)
        return n_columns * n_rows * (1 if section.cell == "Q4" else 2)
    return mesh.file.stat().st_size // BYTES_OF_CELL if mesh.file is not None and mesh.file.is_file() else 0


def open_drawn_case(image: Path, case_file: Path, deformed: Sequence[Path] = ()) -> DrawnCase:
    """Open what is drawn on: the case that is there, or one to start from, as ``ddic new`` writes it.

    Raises InputError where the image or the case cannot be read, or the case is of another image.
    """
    if case_file.suffix != ".toml":
        raise InputError(f"{case_file}: the name of a case file ends in .toml")
    if not case_file.absolute().parent.is_dir():
        raise InputError(f"{case_file}: its folder does not exist; create it")
    if not case_file.exists():
        source = hold_source(image, 2)
        pattern = find_pattern(source)
        text = write_starter_case(case_file, image, deformed, pattern, choose_region(pattern, source))
        return DrawnCase(case_file, text, ScreenImage(source), pattern, CaseRun(case_file))
    if deformed:
        raise InputError(f"--deformed: {case_file} is there already and names its images; leave it out")
    text = read_text(case_file, "case file", "check the path")
    loaded, _ = load_text_leniently(text, case_file)
    if loaded is not None:
        loaded.require_images("ddic draw", "write the box into the case, and look at it by ddic check --plot")
    source = hold_source(image, 2)
    if loaded is not None and not _is_drawn_on(loaded, image):
        raise InputError(f"{image}: {case_file} has another reference image, {loaded.case.imaging.reference}; give "
                         "that")
    return DrawnCase(case_file, text, ScreenImage(source), find_pattern(source), CaseRun(case_file))


def _is_drawn_on(loaded: LoadedCase, image: Path) -> bool:
    return loaded.case.imaging.reference == find_real_path(image.absolute())


class CaseFile:
    """The file of a case, or of its probes, as one tab found and wrote it.

    It is not written over what somebody else wrote since.

    Parameters
    ----------
    path : Path
        The file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.text = self._read()

    def _read(self) -> str | None:
        return read_text(self.path, "case file", "check the path") if self.path.exists() else None

    def write(self, text: str) -> None:
        """Write the file, whole or not at all; raises InputError where it is another one by now."""
        if self._read() != self.text:
            raise InputError(f"{self.path}: was changed since this page was opened; reload the page")
        remove_abandoned(self.path.parent)
        # Lines end as they did.
        ends = "\r\n" if self.text is not None and b"\r\n" in self.path.read_bytes() else "\n"
        with replaced_on_exit(self.path) as temporary:
            temporary.write_text(text, encoding="utf-8", newline=ends)
        self.text = text


def find_mask_outline(loaded: LoadedCase | None, image: ScreenImage) -> Array:
    """Points of the outlines of the mesh's mask, (n, 2), pixels; none where it has none."""
    section = None if loaded is None else loaded.case.mesh.structured
    if section is None or section.mask is None:
        return np.zeros((0, 2))
    try:
        mask = read_mask(section.mask, image.source.extent)
    except InputError:
        return np.zeros((0, 2))
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    return np.vstack([contour[:, 0] for contour in contours]).astype(float) if contours else np.zeros((0, 2))

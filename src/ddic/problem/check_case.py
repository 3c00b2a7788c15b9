"""All inputs of a case validated without solving."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.case.loader import LoadedCase
from ddic.case.schema import Case, ImagesSection, NearSection
from ddic.errors import InputError
from ddic.images.grey_levels import check_finite
from ddic.images.source import ImageSource
from ddic.io.image_file import open_image
from ddic.io.mask_file import read_mask
from ddic.io.partition_file import read_partition
from ddic.io.result_reader import read_result
from ddic.io.result_schema import sidecar_path, summary_path
from ddic.mesh.cell_type import CELL_TYPES
from ddic.mesh.control import find_not_controlled_nodes
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_areas
from ddic.mesh.raster import rasterize
from ddic.mesh.repair import check_pixels
from ddic.partition.ties import Tying
from ddic.problem.mesh_source import build_meshes, mesh_name

SHORTEST_WAVELENGTH = 3.0
"""Elements per cut-off wavelength below which a plane wave is not one on the mesh (aliasing)."""

LONGEST_WAVELENGTH = 1000.0
"""Elements per cut-off wavelength beyond which M is lost in A = M + eta Kbar^T Kbar, whose ratio grows as its
fourth power (1e12 here, of 1e16)."""


@dataclass(frozen=True)
class CheckReport:
    """What the inputs of a case are.

    image_size: (width, height), pixels. bits: bits per pixel of the images' integers, None for floats.
    cell_counts: number of cells by name (T3, Q4). node_sets: number of nodes by name.
    pixels_min, pixels_mean: pixels per cell. n_controlled_dofs: unknowns that the equilibrium gap
    controls, 0 without regularization. output: the result file.
    """

    image_size: tuple[int, int]
    bits: int | None
    n_nodes: int
    n_cells: int
    n_dofs: int
    cell_counts: dict[str, int]
    node_sets: dict[str, int]
    pixels_min: int
    pixels_mean: float
    n_controlled_dofs: int
    output: Path


def check_case(loaded: LoadedCase,
               pixel_counts: Callable[[Mesh, Tying | None], NDArray[np.int64]] | None = None) -> CheckReport:
    """Read and validate the images, masks, mesh, node sets, partition, start and output of a case.

    pixel_counts: gives the number of pixels of each cell, (n_cells,), by default of the images' own. Raises InputError
    with the problems of all inputs, one line each.
    """
    case, problems = loaded.case, _Problems()
    reference = _check_images(case.images, problems)
    for section in case.near:
        _check_images(section, problems)
    with problems.gathered(loaded.path):
        check_output_file(case.output.file)
        _check_nothing_is_overwritten(loaded)
    if case.start.from_result is not None:
        with problems.gathered():
            read_result(case.start.from_result)
    if reference is None:
        raise InputError(problems.lines)
    mesh: Mesh | None = None
    with problems.gathered():
        mesh, tying = build_meshes(case, reference.width, reference.height)
    # What several cameras see of the mesh cannot be said without all of their images.
    if mesh is None or (case.near and problems.lines):
        raise InputError(problems.lines)
    try:
        counts = rasterize(mesh).pixel_counts if pixel_counts is None else pixel_counts(mesh, tying)
    except InputError as error:
        raise InputError([*problems.lines, *(f"{loaded.path}: {line}" for line in error.problems)]) from error
    free = _check_mesh_uses(loaded, mesh, tying, counts, problems)
    if problems.lines:
        raise InputError(problems.lines)
    return _report(case, reference, mesh, tying, counts, free)


class _Problems:
    """Lines gathered from several checks, so that one failure does not hide the next."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    @contextmanager
    def gathered(self, source: Path | None = None) -> Iterator[None]:
        """Keep the lines of an InputError; source: a file to name before each."""
        try:
            yield
        except InputError as error:
            self.lines += [line if source is None else f"{source}: {line}" for line in error.problems]


def _check_images(images: ImagesSection | NearSection, problems: _Problems) -> ImageSource | None:
    """Check both images and their masks; returns the reference image, None if it cannot be read."""
    opened = list[ImageSource]()
    for path, mask_path in ((images.reference, images.reference_mask), (images.deformed, images.deformed_mask)):
        source: ImageSource | None = None
        with problems.gathered():
            source = open_image(path)
            opened.append(source)
        if source is not None:
            with problems.gathered():
                mask = None if mask_path is None else read_mask(mask_path, source.width, source.height)
                check_finite(source, mask)
    if len(opened) == 2:
        with problems.gathered():
            _check_same_size(*opened)
    return opened[0] if opened and opened[0].path == images.reference else None


def _check_same_size(reference: ImageSource, deformed: ImageSource) -> None:
    if (reference.width, reference.height) != (deformed.width, deformed.height):
        raise InputError(f"{deformed.path}: the image is {deformed.width}x{deformed.height} px, but the "
                         f"reference {reference.path} is {reference.width}x{reference.height} px; "
                         "give a pair of one size")


def check_output_file(file: Path) -> None:
    """Check that a result can be written.

    Parameters
    ----------
    file : Path
        Its name.

    Raises
    ------
    InputError
        Where it is a folder, or its folder is missing or cannot be written to.
    """
    folder = file.parent
    if file.is_dir():
        raise InputError(f"output.file: {file} is a folder; give the name of a file")
    if not folder.is_dir():
        raise InputError(f"output.file: there is no folder {folder}; make it first")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"output.file: the folder {folder} cannot be written to; choose another")


def _check_nothing_is_overwritten(loaded: LoadedCase) -> None:
    case = loaded.case
    result = case.output.file
    if result.suffix == ".json":
        raise InputError(f"output.file: {result} is the name of the summary that is written beside the result; "
                         "choose another ending, such as .vtkhdf")
    meshes = [case.mesh, *(near.mesh for near in case.near if near.mesh is not None)]
    inputs = (loaded.path, case.images.reference, case.images.deformed, case.images.reference_mask,
              case.images.deformed_mask, case.solver.partition_file,
              *(path for mesh in meshes
                for path in (mesh.file, None if mesh.structured is None else mesh.structured.mask)),
              *(path for near in case.near for path in (near.reference, near.deformed, near.reference_mask,
                                                        near.deformed_mask, near.mapping_file)))
    sidecars = [sidecar_path(result, camera) for camera in range(len(case.near) + 1)]
    written = {p.resolve() for p in (result, summary_path(result), *sidecars)}
    for path in inputs:
        if path is not None and path.resolve() in written:
            raise InputError(f"output.file: {result} would overwrite the input {path}; choose another name")


def check_wavelength(case: Case, mesh: Mesh) -> None:
    """Check that the cut-off wavelength is one that the mesh carries.

    Parameters
    ----------
    case : Case
        Says it.
    mesh : Mesh
        The whole mesh, pixels.

    Raises
    ------
    InputError
        Where it is shorter than SHORTEST_WAVELENGTH elements or longer than LONGEST_WAVELENGTH.
    """
    wavelength = None if case.regularization is None else case.regularization.cut_off_wavelength
    if wavelength is None:
        return
    size = float(np.sqrt(measure_areas(mesh).mean()))
    if wavelength < SHORTEST_WAVELENGTH * size:
        raise InputError(f"regularization.cut_off_wavelength = {wavelength:g}: the mesh, of elements of {size:.3g} px, "
                         f"carries no wave shorter than {SHORTEST_WAVELENGTH:g} elements; give at least "
                         f"{SHORTEST_WAVELENGTH * size:.3g}, or leave the regularization out")
    if wavelength > LONGEST_WAVELENGTH * size:
        raise InputError(f"regularization.cut_off_wavelength = {wavelength:g}: more than {LONGEST_WAVELENGTH:g} "
                         f"elements of {size:.3g} px, where rounding hides the images (eta grows as its fourth "
                         f"power); give at most {LONGEST_WAVELENGTH * size:.3g}")


def check_mesh(loaded: LoadedCase, mesh: Mesh) -> None:
    """Check what a case asks of a mesh.

    Parameters
    ----------
    loaded : LoadedCase
        The case.
    mesh : Mesh
        The whole mesh, pixels.

    Raises
    ------
    InputError
        With a line for each problem: cells without pixels, node sets, cut-off wavelength, partition.
    """
    problems = _Problems()
    _check_mesh_uses(loaded, mesh, None, rasterize(mesh).pixel_counts, problems)
    if problems.lines:
        raise InputError(problems.lines)


def _check_mesh_uses(loaded: LoadedCase, mesh: Mesh, tying: Tying | None, pixel_counts: NDArray[np.int64],
                     problems: _Problems) -> NDArray[np.int64]:
    """Check what refers to the mesh; returns the nodes that are not controlled."""
    case = loaded.case
    free = np.zeros(0, np.int64)
    with problems.gathered():
        check_pixels(mesh, pixel_counts, mesh_name(case))
    if case.regularization is not None:
        with problems.gathered(loaded.path):
            free = find_not_controlled_nodes(mesh, case.regularization.not_controlled, case.regularization.boxes,
                                        None if tying is None else tying.boundary)
    with problems.gathered(loaded.path):
        check_wavelength(case, mesh)
    if case.solver.partition_file is not None:
        with problems.gathered():
            read_partition(case.solver.partition_file, mesh.n_cells)
    if (case.solver.subdomains or 1) > mesh.n_cells:
        problems.lines.append(f"{loaded.path}: solver.subdomains = {case.solver.subdomains}: the mesh has only "
                              f"{mesh.n_cells} cells; ask for fewer subdomains")
    return free


def _report(case: Case, reference: ImageSource, mesh: Mesh, tying: Tying | None, pixel_counts: NDArray[np.int64],
            free: NDArray[np.int64]) -> CheckReport:
    n_unknown_nodes = mesh.n_nodes if tying is None else tying.n_unknown_nodes
    n_controlled_nodes = n_unknown_nodes - int((free < n_unknown_nodes).sum())
    kinds, numbers = np.unique(mesh.types, return_counts=True)
    saturation = reference.saturation
    return CheckReport(
        image_size=(reference.width, reference.height),
        bits=None if saturation is None else int(saturation).bit_length(),
        n_nodes=mesh.n_nodes,
        n_cells=mesh.n_cells,
        n_dofs=mesh.dim * n_unknown_nodes,
        cell_counts={CELL_TYPES[int(k)].name: int(n) for k, n in zip(kinds, numbers, strict=True)},
        node_sets={name: len(nodes) for name, nodes in mesh.node_sets.items()},
        pixels_min=int(pixel_counts.min()),
        pixels_mean=float(pixel_counts.mean()),
        n_controlled_dofs=0 if case.regularization is None else mesh.dim * n_controlled_nodes,
        output=case.output.file,
    )

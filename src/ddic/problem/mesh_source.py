"""The mesh that a case asks for."""

from __future__ import annotations

import math

import numpy as np

from ddic.case.schema import Case, MappingSection, MeshSection, StructuredSection
from ddic.errors import InputError
from ddic.io.mask_file import read_mask
from ddic.io.mesh_file import read_mesh
from ddic.mesh.mask_outline import OutlinedHole, find_mask_holes
from ddic.mesh.mesh import Mesh, Similarity
from ddic.mesh.repair import check_inside, repair
from ddic.mesh.structured import build_structured_mesh
from ddic.partition.ties import Tying, tie_meshes


def build_mesh(case: Case, width: int, height: int) -> Mesh:
    """Read or make the case's mesh, repair it and check that it lies in the image.

    Parameters
    ----------
    case : Case
        With absolute paths.
    width, height : int
        Size of the images, pixels.

    Returns
    -------
    Mesh
        Fit for measuring, pixels.

    Raises
    ------
    InputError
        With the mesh's file or section named, on all that ``read_mesh``, ``build_structured_mesh``, ``repair`` and
        ``check_inside`` refuse.
    """
    return _mesh_of(case.mesh, describe_mesh_source(case), width, height)


def build_meshes(case: Case, width: int, height: int) -> tuple[Mesh, Tying | None]:
    """Build the case's mesh with the near fields' own meshes in it, tied to what is left of the far elements.

    Parameters
    ----------
    case : Case
        With absolute paths.
    width, height : int
        Size of the far-field images, pixels.

    Returns
    -------
    mesh : Mesh
        Fit for measuring, far-field pixels.
    tying : Tying or None
        How its nodes are tied; None where no near field has a mesh of its own.

    Raises
    ------
    InputError
        On all that ``build_mesh`` and ``tie_meshes`` refuse.
    """
    far = build_mesh(case, width, height)
    near = {}
    for number, section in enumerate(case.near, start=1):
        if section.mesh is not None:
            name = f"near, entry {number}: {_name(section.mesh)}"
            near[number] = _mesh_of(section.mesh, name, width, height)
    if not near:
        return far, None
    return tie_meshes(far, near)


def build_mesh_anywhere(case: Case) -> Mesh:
    """Build the case's mesh wherever it lies, to check what refers to it beside an image that it does not fit.

    Parameters
    ----------
    case : Case
        With absolute paths.

    Returns
    -------
    Mesh
        Not fit for measuring.

    Raises
    ------
    InputError
        Where it cannot be built, or not without an image whose size its mask has.
    """
    if case.mesh.structured is not None and case.mesh.structured.mask is not None:
        raise InputError("mesh.structured.mask: its image cannot be read")
    return repair(_raw_mesh(case.mesh, 0, 0))


def describe_mesh_source(case: Case) -> str:
    """Name the mesh for messages.

    Parameters
    ----------
    case : Case
        Says where it comes from.

    Returns
    -------
    str
        The mesh file, or the section that describes the built-in mesh.
    """
    return _name(case.mesh)


def _name(section: MeshSection) -> str:
    return "mesh.structured" if section.file is None else str(section.file)


def _mesh_of(section: MeshSection, name: str, width: int, height: int) -> Mesh:
    return accept_mesh(_raw_mesh(section, width, height), name, width, height)


def accept_mesh(raw: Mesh, name: str, width: int, height: int) -> Mesh:
    """Repair a mesh and check that it lies in the image.

    Parameters
    ----------
    raw : Mesh
        As it was read or made, pixels.
    name : str
        What messages call it.
    width, height : int
        Size of the images, pixels.

    Returns
    -------
    Mesh
        Fit for measuring.

    Raises
    ------
    InputError
        On all that ``repair`` and ``check_inside`` refuse.
    """
    try:
        mesh = repair(raw)
        check_inside(mesh, width, height)
    except InputError as error:
        raise InputError([f"{name}: {problem}" for problem in error.problems]) from error
    return mesh


def _raw_mesh(section: MeshSection, width: int, height: int) -> Mesh:
    if section.file is not None:
        return read_mesh(section.file, convert_mapping(section.mapping))
    if section.structured is None:
        raise InputError("mesh: give either mesh.file or [mesh.structured]")
    return _structured(section.structured, width, height)


def convert_mapping(section: MappingSection) -> Similarity:
    """Convert a mapping as a case file says it.

    Parameters
    ----------
    section : MappingSection
        Of the case.

    Returns
    -------
    Similarity
        From mesh units to pixels.
    """
    return Similarity(section.scale, math.radians(section.rotation_degrees), section.translation, section.y_up)


def _structured(section: StructuredSection, width: int, height: int) -> Mesh:
    mask = None if section.mask is None else read_mask(section.mask, width, height)
    outlined: list[OutlinedHole] = []
    if mask is not None and section.mask_outline == "snapped":
        outlined, mask = find_mask_holes(mask, section.region, section.element_size), None
    return build_structured_mesh(
        section.region, section.element_size, section.cell,
        circles=[(circle.center, circle.radius) for circle in section.circles],
        polygons=[*(np.array(polygon.vertices) for polygon in section.polygons), *outlined],
        mask=mask,
    )

"""The mesh that a case asks for."""

from __future__ import annotations

import math

import numpy as np

from ddic.case.schema import Case, MappingSection, StructuredSection
from ddic.errors import InputError
from ddic.io.mask_file import read_mask
from ddic.io.mesh_file import read_mesh
from ddic.mesh.mesh import Mesh, Similarity
from ddic.mesh.repair import check_inside, repair
from ddic.mesh.structured import structured_mesh


def build_mesh(case: Case, width: int, height: int) -> Mesh:
    """Read or make the case's mesh, repair it and check that it lies in the image.

    width, height: size of the images, pixels; the case's paths are absolute. Raises InputError, with the
    mesh's file or section named, on all that read_mesh, structured_mesh, repair and check_inside refuse.
    """
    raw = _raw_mesh(case, width, height)
    try:
        mesh = repair(raw)
        check_inside(mesh, width, height)
    except InputError as error:
        raise InputError([f"{mesh_name(case)}: {problem}" for problem in error.problems]) from error
    return mesh


def mesh_name(case: Case) -> str:
    """The mesh file, or the section that describes the built-in mesh, for messages."""
    return "mesh.structured" if case.mesh.file is None else str(case.mesh.file)


def _raw_mesh(case: Case, width: int, height: int) -> Mesh:
    if case.mesh.file is not None:
        return read_mesh(case.mesh.file, _similarity(case.mesh.mapping))
    if case.mesh.structured is None:
        raise InputError("mesh: give either mesh.file or [mesh.structured]")
    return _structured(case.mesh.structured, width, height)


def _similarity(mapping: MappingSection) -> Similarity:
    return Similarity(mapping.scale, math.radians(mapping.rotation_degrees), mapping.translation)


def _structured(section: StructuredSection, width: int, height: int) -> Mesh:
    return structured_mesh(
        section.region, section.element_size, section.cell,
        circles=[(circle.center, circle.radius) for circle in section.circles],
        polygons=[np.array(polygon.vertices) for polygon in section.polygons],
        mask=None if section.mask is None else read_mask(section.mask, width, height),
    )

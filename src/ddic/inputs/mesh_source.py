"""The mesh that a case asks for, the cut-off wavelengths that its elements carry, and a simulation's field."""

import math

import numpy as np

from ddic.arrays import Array, BoolArray
from ddic.case.schema import (
    Case,
    MappingSection,
    MeshedSection,
    MeshSection,
    RegionSection,
    ShapeSection,
    StiffnessSection,
    StructuredSection,
    UnstructuredSection,
)
from ddic.errors import InputError
from ddic.images.window import Window
from ddic.io.mesh_file import read_mesh
from ddic.io.simulations.simulation_file import SimulatedField, read_simulation
from ddic.io.volume_file import open_mask
from ddic.mesh.grid import GridLines
from ddic.mesh.holes import OutlinedHole, RegionLike, convert_region, find_mask_holes
from ddic.mesh.mesh import Mesh, Similarity
from ddic.mesh.repair import check_inside, check_joints, repair
from ddic.mesh.structured import build_grid_lines, build_structured_mesh, count_cells
from ddic.mesh.unstructured import build_unstructured_mesh
from ddic.parallel.node import read_available_memory
from ddic.parallel.team import require_held
from ddic.partition.ties import Tying, tie_meshes

BYTES_PER_CELL = 520
"""Memory that a built-in mesh takes for each cell while it is made, measured on 62,500 and on 1,000,000 cells alike."""

BYTES_OF_GMSH = 2700
"""The same that gmsh takes for a square of ``element_size``, measured on 370,000 triangles; of quadrilaterals 1,000."""

SHORTEST_WAVELENGTH = 3.0
"""Elements per cut-off wavelength below which a plane wave is not one on the mesh (aliasing)."""

LONGEST_WAVELENGTH = 1000.0
"""Elements per cut-off wavelength beyond which M is lost in A = M + eta Kbar^T Kbar, whose ratio grows as its
fourth power (1e12 here, of 1e16)."""

NO_INNER_NODE = ("the mesh has no interior node, so no wavelength can be given a weight; use a finer mesh or give "
                 "regularization.eta")
"""What is said of a mesh all of whose nodes lie on its boundary."""


def build_meshes(case: Case, extent: Window) -> tuple[Mesh, Tying | None]:
    """Build the case's mesh with the near fields' own meshes in it, tied to what is left of the far elements.

    Paths of the case are absolute, sizes and nodes in far-field pixels; the mesh lies in the image and is fit for
    measuring. There is no tying where no near field has a mesh of its own. Raises InputError, with the mesh's file or
    section named, on all that ``read_mesh``, ``build_structured_mesh``, ``accept_mesh`` and ``tie_meshes`` refuse.
    """
    far = _build_mesh(case.mesh, case.mesh.name, extent)
    near = {}
    for number, section in enumerate(case.near, start=1):
        if section.mesh is not None:
            near[number] = _build_mesh(section.mesh, f"near, entry {number}: {section.mesh.name}", extent)
    if not near:
        return far, None
    return tie_meshes(far, near)


def is_plain_grid(case: Case) -> bool:
    """Tell whether a case asks for a rectangle or a box of equal cells that nothing cuts, ties or splits specially."""
    section = case.mesh.structured
    if section is None or section.cell != "Q4" or isinstance(section.region, ShapeSection):
        return False
    if section.circles or section.polygons or section.mask is not None:
        return False
    has_parts = case.regularization is not None and bool(case.regularization.stiffness)
    is_whole = bool(case.near or case.discontinuity or case.identification is not None or has_parts)
    return not is_whole and case.solver.partition in ("auto", "blocks")


def build_plain_grid(case: Case) -> GridLines:
    """Build the lines of the rectangle that a case asks for; raises InputError where cells would hold no pixel."""
    section = require_held(case.mesh.structured)
    _check_pixels(section, case.mesh.name)
    return build_grid_lines(section.box, section.element_size)


def build_mesh_anywhere(case: Case) -> Mesh:
    """Build the case's mesh wherever it lies, to check what refers to it beside an image that it does not fit.

    It is not fit for measuring. Raises InputError where it cannot be built, or not without an image whose size its mask
    has.
    """
    if case.mesh.structured is not None and case.mesh.structured.mask is not None:
        raise InputError("mesh.structured.mask: its image cannot be read")
    return repair(_raw_mesh(case.mesh, Window.of_size(*[0] * case.dim)))


def _build_mesh(section: MeshSection, name: str, extent: Window) -> Mesh:
    raw = _raw_mesh(section, extent)
    return accept_mesh(raw, name, extent, is_built_in=section.structured is not None)


def accept_mesh(raw: Mesh, name: str, extent: Window, *, is_built_in: bool = False) -> Mesh:
    """Repair a mesh and check that it lies in the image and its cells, unless they are built in, meet side to side.

    ``name`` is what messages call it. Raises InputError on all that ``repair``, ``check_inside`` and ``check_joints``
    refuse.
    """
    try:
        mesh = repair(raw)
        check_inside(mesh, extent)
        if not is_built_in:
            check_joints(mesh)
    except InputError as error:
        raise InputError([f"{name}: {problem}" for problem in error.problems]) from error
    return mesh


def _raw_mesh(section: MeshSection, extent: Window) -> Mesh:
    if section.file is not None:
        return read_mesh(section.file, convert_mapping(section.mapping), len(extent.sizes))
    if section.unstructured is not None:
        return _unstructured(section.unstructured)
    return _structured(require_held(section.structured), extent)


def convert_mapping(section: MappingSection) -> Similarity:
    """Convert a mapping as a case file says it, from mesh units to pixels."""
    return Similarity(section.scale, math.radians(section.rotation_degrees), section.translation, section.y_up)


def read_case_simulation(case: Case) -> SimulatedField:
    """Read the simulation that a case names; raises InputError where it cannot be."""
    section = require_held(case.simulation)
    mapping = section.mapping if "mapping" in section.model_fields_set else case.mesh.mapping
    return read_simulation(section.file, convert_mapping(mapping), case.dim, section.step, section.time, section.field)


def find_cells_in(section: RegionSection, mesh: Mesh) -> BoolArray:
    """Tell which cells, (n_cells,), have their centroid in a region of a case."""
    region: RegionLike = section.shape.region if isinstance(section.shape, ShapeSection) else section.shape
    outline, centroids = convert_region(region, f"region, {section.name}"), mesh.centroids
    if outline is not None:
        return np.asarray(outline.measure_distance(centroids) < 0)
    low, high = np.reshape(np.asarray(region, np.float64), (2, -1))
    return np.asarray(((centroids >= low) & (centroids <= high)).all(axis=1))


def share_cells(case: Case, mesh: Mesh) -> list[BoolArray]:
    """Share the cells among the materials that are sought, (n_cells,) each; one of no region has what is left.

    Raises InputError where a material has no cell, or a cell no material.
    """
    materials, is_free = require_held(case.identification).material, np.ones(mesh.n_cells, dtype=bool)
    regions = {region.name: region for region in case.region}
    found = []
    for material in materials:
        cells = np.zeros(mesh.n_cells, dtype=bool)
        if material.region is not None:
            cells = find_cells_in(regions[material.region], mesh) & is_free
            if not cells.any():
                raise InputError(f'identification.material.region = "{material.region}": holds no cell of its own; '
                                 "move the region, or leave the material out")
        is_free &= ~cells
        found.append(cells)
    if is_free.any() and all(material.region is not None for material in materials):
        raise InputError(f"identification.material: {is_free.sum()} cells are of no material; give one without a "
                         "region")
    return [is_free if material.region is None else cells for material, cells in zip(materials, found, strict=True)]


def check_stiffness(case: Case, mesh: Mesh) -> None:
    """Refuse, with an InputError, parts of other stiffness that hold no cell."""
    for section, cells in _list_stiffness(case, mesh):
        if not cells.any():
            raise InputError(f'regularization.stiffness.region = "{section.region}": holds no cell; move the region '
                             "(px), or leave it out")


def weigh_stiffness(case: Case, mesh: Mesh) -> Array:
    """Weigh the stiffness of cells, (n_cells,), by the regions of the regularization; 1 in no region."""
    relative = np.ones(mesh.n_cells)
    for section, cells in _list_stiffness(case, mesh):
        relative[cells] = section.ratio
    return relative


def _list_stiffness(case: Case, mesh: Mesh) -> list[tuple[StiffnessSection, BoolArray]]:
    """Parts of other stiffness with their cells, (n_cells,), none without regularization."""
    regions = {region.name: region for region in case.region}
    parts = () if case.regularization is None else case.regularization.stiffness
    return [(section, find_cells_in(regions[section.region], mesh)) for section in parts]


def _check_pixels(section: MeshedSection, name: str) -> int:
    """Refuse a mesh that has elements without a pixel whatever its holes; the number of others comes back."""
    n_along = count_cells(section.box, section.element_size, name)
    low, high = np.reshape(section.box, (2, -1))
    n_pixels = (np.floor(high + 1) - np.ceil(low)).astype(np.int64)
    if (np.array(n_along) > n_pixels).any():
        elements, pixels = (" x ".join(map(str, along)) for along in (n_along, n_pixels))
        raise InputError(f"{name}: element_size = {section.element_size:g} asks for {elements} elements on {pixels} "
                         "pixels: some hold no pixel; use larger elements")
    return math.prod(n_along)


def _check_size(section: MeshedSection, name: str, bytes_per_cell: int) -> None:
    """Refuse a mesh that has elements without a pixel, or does not fit into memory, before it is built."""
    n_elements = _check_pixels(section, name)
    needed, left = n_elements * bytes_per_cell, read_available_memory()
    if needed > left:
        n_unknowns = len(section.box) // 2 * n_elements
        raise InputError(f"{name}: {n_elements:.3g} elements, {n_unknowns:.3g} unknowns, take "
                         f"{needed / 2**30:.3g} GiB to build alone, and {left / 2**30:.3g} GiB are left here; use "
                         "larger elements, or a machine with more memory")


def _structured(section: StructuredSection, extent: Window) -> Mesh:
    _check_size(section, "mesh.structured", BYTES_PER_CELL)
    mask = None if section.mask is None else open_mask(section.mask, extent)
    outlined: list[OutlinedHole] = []
    if mask is not None and section.mask_outline == "snapped":
        outlined, mask = find_mask_holes(mask.read(extent) != 0, section.box, section.element_size), None
    circles, polygons = _list_holes(section)
    return build_structured_mesh(_region(section), section.element_size, section.cell, circles,
                                 [*polygons, *outlined], mask)


def _unstructured(section: UnstructuredSection) -> Mesh:
    _check_size(section, "mesh.unstructured", BYTES_OF_GMSH)
    return build_unstructured_mesh(_region(section), section.element_size, section.cell, *_list_holes(section))


def _region(section: MeshedSection) -> RegionLike:
    """The region as functions that mesh it take it."""
    given: RegionLike = section.region.region if isinstance(section.region, ShapeSection) else section.region
    return given


def _list_holes(section: MeshedSection) -> tuple[list[tuple[tuple[float, float], float]], list[Array]]:
    """Circles and polygons as functions that mesh a region take them."""
    return ([(circle.center, circle.radius) for circle in section.circles],
            [np.array(polygon.vertices) for polygon in section.polygons])


def check_weight_fits(eta: float, modulus: float, texture: float, size: float, dim: int) -> None:
    """Check that the images are not lost beside the weight of the equilibrium gap.

    A weight stands for the wavelength 2 pi / k at which eta (modulus k^2)^2 size^dim / 2, the gap of a plane wave per
    pixel, equals texture / (2 dim), what its images say, both means over the wave's phase and direction. ``modulus`` is
    that of a strain in one direction, that of Young being 1; ``texture`` is the mean of |grad f|^2, (grey level /
    px)^2, as eta; ``size`` is that of the elements, pixels. Raises InputError where that wavelength is longer than
    LONGEST_WAVELENGTH elements.
    """
    # A node's share of the gap is an element's force, hence size^dim; its square is per node, hence 1 / size^dim.
    largest = texture / size**dim / dim * (LONGEST_WAVELENGTH / (2 * math.pi) * size) ** 4 / modulus**2
    if eta > largest:
        raise InputError(f"regularization.eta = {eta:g}: it stands for a cut-off wavelength of more than "
                         f"{LONGEST_WAVELENGTH:g} elements of {size:.3g} px, where rounding hides the images; give at "
                         f"most {largest:.2g}, or regularization.cut_off_wavelength")


def check_wavelength_fits(wavelength: float, size: float) -> None:
    """Check that elements of a size carry a cut-off wavelength, pixels both.

    Raises InputError where it is shorter than SHORTEST_WAVELENGTH elements or longer than LONGEST_WAVELENGTH.
    """
    if wavelength < SHORTEST_WAVELENGTH * size:
        raise InputError(f"regularization.cut_off_wavelength = {wavelength:g}: the mesh, of elements of {size:.3g} px, "
                         f"carries no wave shorter than {SHORTEST_WAVELENGTH:g} elements; give at least "
                         f"{SHORTEST_WAVELENGTH * size:.3g}, or leave the regularization out")
    if wavelength > LONGEST_WAVELENGTH * size:
        raise InputError(f"regularization.cut_off_wavelength = {wavelength:g}: more than {LONGEST_WAVELENGTH:g} "
                         f"elements of {size:.3g} px, where rounding hides the images (eta grows as its fourth "
                         f"power); give at most {LONGEST_WAVELENGTH * size:.3g}")

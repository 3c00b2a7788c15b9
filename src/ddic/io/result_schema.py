"""Names, version and standard fields of the result file (docs/result-file.md)."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

SCHEMA_VERSION = "1.11"
VERSION, Y_AXIS = OF_FORMAT = "ddic_schema", "y_axis"
VTKHDF_VERSION = (2, 0)

VTKHDF = "VTKHDF"
PIECES = ("NumberOfPoints", "NumberOfCells", "NumberOfConnectivityIds")
TOPOLOGY = (*PIECES, "Connectivity", "Offsets", "Types")
"""Datasets that, with the places of the points, are a mesh in pieces; the first ones have a number a piece."""

POINT_DATA = "VTKHDF/PointData"
CELL_DATA = "VTKHDF/CellData"
RESIDUAL_IMAGE = "residual_image"
RESIDUAL = "residual"
GAUSS_NEWTON = "history/gauss_newton"
KRYLOV = "history/krylov"
CORRECTIONS = "history/corrections"
DETECTION = "detection"
SEPARATED = "separated"
PGD = "PGD-DIC"
PHASES = "history/phases"
CASE = "case"
PROVENANCE = "provenance"
TIME = "time"
UNITS = "units"
STATUS, FAILURE = OF_STATUS = "status", "failure"
CONVERGED, NOT_CONVERGED = "converged", "not converged"
VERDICT, REASONS = OF_VERDICT = "verdict", "verdict_reasons"
TRUST, LOOK, DISTRUST = "trust", "look", "do not trust"
SHOWS = "shows"
NOISE_FLOOR = "noise_floor_px"
NEAR_PREFIX = "near_"
SERIES, STEPS, FRAMES = "series", "VTKHDF/Steps", "frames"
UNCERTAINTY = "uncertainty"
OPENING_DEVIATIONS = "uncertainty/opening"
COMPARISON, COMPARED_REGIONS = "comparison", "comparison/regions"
IDENTIFICATION = "identification"
TIME_MODES = "time_modes"
ATTRIBUTE_GROUPS = (CASE, PROVENANCE, TIME, UNITS, UNCERTAINTY, COMPARISON, IDENTIFICATION)

DISPLACEMENT = "displacement"
DISPLACEMENT_MESH_UNITS = "displacement_mesh_units"
DISPLACEMENT_PHYSICAL = "displacement_physical"
INDEPENDENT = "independent_displacement"
GLOBAL_NODE_ID = "GlobalNodeId"
GLOBAL_CELL_ID = "GlobalCellId"
CAMERA = "Camera"
SUBDOMAIN_ID = "SubdomainId"
STRAIN_INFINITESIMAL = "strain_infinitesimal"
STRAIN_GREEN_LAGRANGE = "strain_green_lagrange"
NODAL_INFINITESIMAL = "nodal_strain_infinitesimal"
NODAL_GREEN_LAGRANGE = "nodal_strain_green_lagrange"
NODAL_HENCKY = "nodal_strain_hencky"
NODAL_STRAINS = {"infinitesimal": NODAL_INFINITESIMAL, "green-lagrange": NODAL_GREEN_LAGRANGE, "hencky": NODAL_HENCKY}
NODAL_PRINCIPAL = ("nodal_principal_strain_1", "nodal_principal_strain_2", "nodal_principal_strain_3")
NODAL_VON_MISES = "nodal_von_mises_strain"
RESIDUAL_RMS = "residual_rms"
RESIDUAL_N_PIXELS = "residual_n_pixels"
EQUIVALENT_ERROR = "equivalent_error"
DOUBTFUL = "doubtful"
EXCLUDED = "excluded"
PLASTIC_STRAIN = "plastic_strain"
SIGMA_DISPLACEMENT = ("sigma_u", "sigma_v", "sigma_w")
"""Names by axis, of which a field in the plane has the first two; so have the principal strains above."""
REGULARIZATION_BIAS = "regularization_bias"
SIMULATED, SIMULATION_DIFFERENCE = "simulated_displacement", "simulation_difference"
NORMALISED_DIFFERENCE = "normalised_difference"

EXCLUDED_STATES = (1, 2, 3, 5)
"""Values of the field ``excluded`` of cells none of whose pixels counts; 4 marks one that is used though mechanics hold
it off."""



@dataclass(frozen=True)
class Verdict:
    """Whether a field can be trusted.

    Attributes
    ----------
    word : {"trust", "look", "do not trust"}
        Trust it; look at some places first; or do not trust it.
    reasons : tuple of str
        Why not, where, and what to do about it; empty where it can be trusted.
    """

    word: str
    reasons: tuple[str, ...] = ()

    def describe(self) -> str:
        """Say it in plain words, in a line."""
        if self.word == TRUST:
            return "trust this field"
        what = "look before you trust this field" if self.word == LOOK else "do not trust this field"
        return f"{what}: {'; '.join(self.reasons)}"


VECTOR, SYMMETRIC_TENSOR = 3, 6
AXES_OF_IMAGE, AXES_OF_MESH_FILE = "image", "mesh file"
AXES = "xyz"
COMPONENTS = {"xx": 0, "yy": 1, "zz": 2, "xy": 3, "yz": 4, "xz": 5}
"""Places of a symmetric tensor's components in the file."""


def list_components(dim: int) -> dict[str, int]:
    """List the components that a symmetric tensor has in the plane or in space, with their places in the file."""
    return {name: place for name, place in COMPONENTS.items() if set(name) <= set(AXES[:dim])}


def list_sigma_strains(dim: int) -> tuple[str, ...]:
    """Name the standard deviations of the strains at the nodes: sigma_exx, sigma_eyy, ..."""
    return tuple(f"sigma_e{component}" for component in list_components(dim))


def list_cell_sigma_strains(dim: int) -> tuple[str, ...]:
    """Name the standard deviations of the strains of the cells: cell_sigma_exx, cell_sigma_eyy, ..."""
    return tuple(f"cell_{name}" for name in list_sigma_strains(dim))


@dataclass(frozen=True)
class FieldSpec:
    """A field at nodes or on cells.

    Attributes
    ----------
    name : str
        Of the dataset.
    n_components : int
        1, 3 (vector) or 6 (symmetric tensor XX YY ZZ XY YZ XZ).
    dtype : dtype
        Of a component.
    unit, description : str
        Stored beside the values.
    axes : str
        AXES_OF_IMAGE, or AXES_OF_MESH_FILE, whose vectors no flip of the image's y concerns; stored as well.
    """

    name: str
    n_components: int
    dtype: DTypeLike
    unit: str
    description: str
    axes: str = AXES_OF_IMAGE


def point_fields(length_unit: str | None, *, independent: bool = False) -> tuple[FieldSpec, ...]:
    """List the fields at the nodes, in the order of the file; ``length_unit`` is the pixel size's, None if unknown.

    ``independent`` asks for those of subdomains by themselves too.
    """
    fields: tuple[FieldSpec, ...] = (
        FieldSpec(DISPLACEMENT, VECTOR, np.float64, "px", "displacement in pixels, mean of interface copies"),
        FieldSpec(DISPLACEMENT_MESH_UNITS, VECTOR, np.float64, "mesh unit",
                  "displacement in the axes and units of the mesh file", AXES_OF_MESH_FILE),
        FieldSpec(GLOBAL_NODE_ID, 1, np.int64, "1", "number of the node in the whole mesh"),
    )
    if length_unit is not None:
        fields = (*fields, FieldSpec(DISPLACEMENT_PHYSICAL, VECTOR, np.float64, length_unit,
                                     "displacement times the pixel size"))
    if independent:
        fields = (*fields, FieldSpec(INDEPENDENT, VECTOR, np.float64, "px", "displacement that the piece's subdomain "
                                     "measured by itself, before subdomains were coupled; nodes that pieces share "
                                     "have one each"))
    return fields


def nodal_strain_fields(dim: int = 2) -> tuple[FieldSpec, ...]:
    """List the strains at the nodes, recovered from the cells around them, in the order of the file."""
    of_hencky = "of the logarithmic strain"
    places = ("larger", "smaller") if dim == 2 else ("largest", "middle", "smallest")
    in_the_plane, constant = (" in the plane", ", volume constant") if dim == 2 else ("", "")
    return (
        FieldSpec(NODAL_INFINITESIMAL, SYMMETRIC_TENSOR, np.float64, "1", "infinitesimal strain at the node"),
        FieldSpec(NODAL_GREEN_LAGRANGE, SYMMETRIC_TENSOR, np.float64, "1", "Green-Lagrange strain at the node"),
        FieldSpec(NODAL_HENCKY, SYMMETRIC_TENSOR, np.float64, "1", "logarithmic strain (Hencky) at the node, ln U"),
        *(FieldSpec(name, 1, np.float64, "1", f"{place} principal value{in_the_plane} {of_hencky}")
          for name, place in zip(NODAL_PRINCIPAL, places, strict=False)),
        FieldSpec(NODAL_VON_MISES, 1, np.float64, "1", f"equivalent strain of von Mises {of_hencky}{constant}"),
    )


def cell_fields(n_cameras: int = 1, *, plastic: bool = False) -> tuple[FieldSpec, ...]:
    """List the fields on the cells, in the order of the file; with several cameras, that of each cell too."""
    fields: tuple[FieldSpec, ...] = (
        FieldSpec(STRAIN_INFINITESIMAL, SYMMETRIC_TENSOR, np.float64, "1", "infinitesimal strain at the cell's centre"),
        FieldSpec(STRAIN_GREEN_LAGRANGE, SYMMETRIC_TENSOR, np.float64, "1",
                  "Green-Lagrange strain at the cell's centre"),
        FieldSpec(RESIDUAL_RMS, 1, np.float64, "grey level", "root mean square of f(x) - g(x + u)"),
        FieldSpec(RESIDUAL_N_PIXELS, 1, np.int64, "px", "number of pixels correlated"),
        FieldSpec(EQUIVALENT_ERROR, 1, np.float64, "px", "error that would leave the residual beyond noise"),
        FieldSpec(DOUBTFUL, 1, np.uint8, "1", "1 where the residual is that of an error, or no pixel counts"),
        FieldSpec(EXCLUDED, 1, np.uint8, "1", "0 where the cell is measured, else why not: 1 it has no texture, 2 it "
                  "shows something else than the reference, 3 too few of its pixels are in both images, 5 none of "
                  "the reference image counts, masked or saturated; 4 it counts, though it is seen beside where "
                  "mechanics hold it"),
        FieldSpec(SUBDOMAIN_ID, 1, np.int32, "1", "subdomain that owns the cell"),
        FieldSpec(GLOBAL_CELL_ID, 1, np.int64, "1", "number of the cell in the whole mesh"),
    )
    if plastic:
        fields = (*fields, FieldSpec(PLASTIC_STRAIN, 1, np.float64, "1", "equivalent plastic strain of the "
                                     "regularization's material, mean over the cell"))
    if n_cameras == 1:
        return fields
    return (*fields, FieldSpec(CAMERA, 1, np.int32, "1", "camera that measures the cell: 0 the far field, 1 ... near"))


def uncertainty_point_fields(dim: int = 2, *, regularized: bool) -> tuple[FieldSpec, ...]:
    """List what a case may ask of errors at nodes, with the bias if ``regularized``, in the order of the file."""
    of_noise = "standard deviation that the images' noise leaves in"
    fields = (
        *(FieldSpec(name, 1, np.float64, "px", f"{of_noise} the displacement along {axis}")
          for name, axis in zip(SIGMA_DISPLACEMENT, AXES[:dim], strict=False)),
        *(FieldSpec(name, 1, np.float64, "1", f"{of_noise} the infinitesimal strain {component} at the node")
          for name, component in zip(list_sigma_strains(dim), list_components(dim), strict=True)),
    )
    if not regularized:
        return fields
    return (*fields, FieldSpec(REGULARIZATION_BIAS, VECTOR, np.float64, "px",
                               "estimated displacement less the true one, as far as regularization is the reason"))


def list_comparison_fields() -> tuple[FieldSpec, ...]:
    """List what a comparison with a simulation has at the nodes, in the order of the file."""
    return (
        FieldSpec(SIMULATED, VECTOR, np.float64, "px", "displacement of a simulation, levelled: as these images, this "
                  "mesh and this regularization would show it"),
        FieldSpec(SIMULATION_DIFFERENCE, VECTOR, np.float64, "px", "measured displacement less that of the simulation"),
        FieldSpec(NORMALISED_DIFFERENCE, VECTOR, np.float64, "1", "the same over its standard deviation"),
    )


def list_mode_fields(n_modes: int) -> tuple[FieldSpec, ...]:
    """List the modes of a series at the nodes, in the order of the file."""
    return tuple(FieldSpec(get_mode_name(number), VECTOR, np.float64, "px", "field of space that an amplitude of each "
                           "frame multiplies") for number in range(1, n_modes + 1))


def get_mode_name(number: int) -> str:
    """Name a mode of a series, from 1."""
    return f"time_mode_{number}"


def uncertainty_cell_fields(dim: int = 2) -> tuple[FieldSpec, ...]:
    """List what is known of the errors on the cells, where the case asks for it, in the order of the file."""
    return tuple(FieldSpec(name, 1, np.float64, "1", "standard deviation that the images' noise leaves in the "
                           f"infinitesimal strain {component} at the cell's centre")
                 for name, component in zip(list_cell_sigma_strains(dim), list_components(dim), strict=True))


def list_all_fields() -> tuple[FieldSpec, ...]:
    """List all fields that a result may have, at the nodes and on the cells: in space, which has all of a plane's."""
    return (*point_fields("px", independent=True), *nodal_strain_fields(3), *cell_fields(2, plastic=True),
            *uncertainty_point_fields(3, regularized=True), *list_comparison_fields(), *uncertainty_cell_fields(3))


def begin_file(file: Any, *, flipped: bool) -> None:
    """Note by which schema a file is written, and whether its y is up (``flipped``) or down."""
    file.attrs[VERSION] = SCHEMA_VERSION
    file.attrs[Y_AXIS] = "up" if flipped else "down"


def is_flipped(file: Any) -> bool:
    """Tell whether y is up in a file."""
    return str(file.attrs[Y_AXIS]) == "up"


def create_vtk_group(file: Any, kind: str) -> Any:
    """Create the group that VTK reads, an ``UnstructuredGrid`` or ``ImageData``, and return it."""
    group = file.create_group(VTKHDF)
    group.attrs["Version"] = np.array(VTKHDF_VERSION, np.int64)
    # VTK's reader wants fixed-length ASCII here, not h5py's variable-length UTF-8.
    group.attrs.create("Type", np.bytes_(kind))
    return group


def get_case(attributes: Mapping[str, Mapping[str, Any]]) -> Any:
    """Get the case that stands among the attributes of a result: sections by name, of keys by name."""
    return json.loads(str(attributes.get(CASE, {}).get("json", "{}")))


def near_group(camera: int) -> str:
    """Name the group with what is known of a near-field set-up, numbered from 1: ``near_1``, ``near_2``, ..."""
    return f"{NEAR_PREFIX}{camera}"


def residual_group(camera: int) -> str:
    """Name the group of a camera's residual image: ``residual_image`` of camera 0, ``residual_image_near_1`` of 1."""
    return RESIDUAL_IMAGE if camera == 0 else f"{RESIDUAL_IMAGE}_near_{camera}"


def summary_path(result: Path) -> Path:
    """Name the summary beside a result file: NAME.json."""
    return result.with_suffix(".json")


def not_converged_path(result: Path) -> Path:
    """Name the file of a field that did not converge, beside the result file asked for: NAME.not_converged.vtkhdf."""
    return _insert(result, "not_converged")


def frames_path(result: Path) -> Path:
    """Name the folder, beside the result, that holds the finished frames of a series until it is whole: NAME.frames."""
    return result.with_suffix(".frames")


def frame_group(number: int) -> str:
    """Name the group with what a series knows of a frame beside its fields: ``frames/000001`` for the first one."""
    return f"{FRAMES}/{number:06d}"


def earlier_path(result: Path) -> Path:
    """Name the file to which a failed run moves an earlier result, in the same folder: NAME.earlier.vtkhdf."""
    return _insert(result, "earlier")


def _insert(path: Path, word: str) -> Path:
    # Without an ending of its own, the word would be taken for one.
    return path.with_name(f"{path.stem}.{word}{path.suffix or '.vtkhdf'}")


def sidecar_path(path: Path, camera: int = 0) -> Path:
    """Name the ImageData file that shows a camera's residual image: NAME.residual.vtkhdf, NAME.near_1.residual.vtkhdf.

    ``camera`` is 0 for the far camera, or the only one; then the near ones.
    """
    near = "" if camera == 0 else f".near_{camera}"
    return path.with_name(f"{path.stem}{near}.residual.vtkhdf")


def physical_path(result: Path) -> Path:
    """Name the file that shows a result in its length unit, beside it: NAME.physical.vtkhdf."""
    return result.with_name(f"{result.stem}.physical.vtkhdf")


def pick_components(tensors: NDArray[Any], dim: int) -> NDArray[Any]:
    """Pick xx, yy, xy, (n, 3), or all in space, of symmetric tensors as the file has them, (n, 6)."""
    return tensors[:, list(list_components(dim).values())]


def flip_components(values: NDArray[Any]) -> NDArray[Any]:
    """Mirror scalars, vectors or symmetric tensors, (n,), (n, 3) or (n, 6), in y, as a copy; it is its own inverse.

    The components with one y change sign: Y of a vector, XY and YZ of a tensor. Scalars stay as they are.
    """
    n_components = values.shape[1] if values.ndim == 2 else 1
    columns = {VECTOR: [1], SYMMETRIC_TENSOR: [3, 4]}.get(n_components, [])
    flipped = values.copy()
    for column in columns:
        flipped[:, column] = -flipped[:, column]
    return flipped

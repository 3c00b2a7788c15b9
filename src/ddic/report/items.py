"""What good-practices guides for DIC ask to be stated, with its value or that it is not recorded.

The items are those that the International Digital Image Correlation Society's guide (2018) asks of one camera and a
plane specimen, said for finite elements: an element stands where a subset does. docs/report.md compares them. They are
said of volumes likewise. How the images were taken is told in the words of the case, beside what they are like, and
where the residual is worst.
All of it comes from a result, its summary and, where they are still there, its images.
"""

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.images.binned import BLUR_NOTE
from ddic.images.grey_levels import measure_feature_size, measure_grey_levels
from ddic.images.source import ImageSource
from ddic.images.window import Window
from ddic.io import result_schema as schema
from ddic.io.image_file import ImageFile, open_image
from ddic.io.result_reader import Result
from ddic.io.volume_file import hold_source
from ddic.mesh.quality import measure_covered_areas
from ddic.plots.canvas import find_length_unit
from ddic.plots.figures import find_image, is_there
from ddic.probes.metrology import Metrology, estimate_metrology, find_chain
from ddic.probes.probes import PointProbe

NOT_RECORDED = "not recorded"
"""In place of a value that the result does not hold."""

NOT_STATED = "not stated in the case"
"""In place of a value that only the user knows."""


@dataclass(frozen=True, eq=False)
class Gathered:
    """A result and what belongs to it.

    Attributes
    ----------
    result : Result
        What was measured.
    case : dict
        The validated case with all defaults; empty where it is not recorded.
    summary : dict
        Of the run; empty where its file is not beside the result.
    images : dict of ImageSource
        ``reference`` and ``deformed``, images or volumes, those of them that are still there.
    absent : tuple of str
        What could not be found, one sentence each.
    """

    result: Result
    case: Mapping[str, Any]
    summary: Mapping[str, Any]
    images: Mapping[str, ImageSource]
    absent: tuple[str, ...]

    @property
    def is_of_volumes(self) -> bool:
        """Whether volumes were measured, not images."""
        return self.result.mesh.dim == 3

    @property
    def imaging_name(self) -> str:
        """The section of the case that names them."""
        return "volumes" if self.is_of_volumes else "images"

    @property
    def imaging(self) -> Mapping[str, Any]:
        """What that section says."""
        return self.get_section(self.imaging_name)

    def get_section(self, name: str) -> Mapping[str, Any]:
        """Get a section of the case, such as ``images``; empty where the case has none."""
        return self.case.get(name) or {}

    def get_attribute(self, group: str, name: str) -> Any:
        """Get an attribute of the result file; None where it is not recorded."""
        value: Any = self.result.attributes.get(group, {}).get(name)
        return value.item() if hasattr(value, "item") else value

    @cached_property
    def noise_floor(self) -> float:
        """RMS displacement that noise leaves, pixels; nan where it is not recorded."""
        for value in (self.get_attribute(schema.CASE, schema.NOISE_FLOOR), self.summary.get("noise_floor_px")):
            if value is not None:
                return float(value)
        return float("nan")

    @cached_property
    def last_residual(self) -> float:
        """Standard deviation of the residual, grey levels; nan where no table tells it."""
        if self.summary.get("residual_std_grey") is not None:
            return float(self.summary["residual_std_grey"])
        for table in (self.result.gauss_newton, self.result.corrections):
            if len(table.get("residual_std_grey", ())):
                return float(table["residual_std_grey"][-1])
        return float("nan")


def gather_all(result: Result, image: Path | None = None) -> Gathered:
    """Gather what a report on a result says, with a sentence for each thing that is no longer there.

    ``image`` is a reference image in place of the one that the result names; raises InputError where it is missing.
    """
    absent: list[str] = []
    summary = _read_summary(result, absent)
    if image is not None and not is_there(image):
        raise InputError(f"{image}: no such image; check --image")
    images: dict[str, ImageSource] = {}
    kind = "image" if result.mesh.dim == 2 else "volume"
    for name, asked in (("reference", image), ("deformed", None)):
        path = asked or find_image(result, name)
        if path is not None:
            images[name] = open_image(path) if result.mesh.dim == 2 else hold_source(path, 3)
            continue
        named = Path(str(result.attributes.get(schema.PROVENANCE, {}).get(f"{name}_path", "")))
        # In place of a file's name, images of arrays are told by what they are.
        in_memory = not named.is_absolute() and not named.suffix
        where = "was in memory" if in_memory else f"is no longer at {named}"
        absent.append(f"The {name} {kind} {where}: what it alone tells is not in this report.")
    return Gathered(result, schema.get_case(result.attributes), summary, images, tuple(absent))


def _read_summary(result: Result, absent: list[str]) -> Mapping[str, Any]:
    """The summary beside a result file, if it is this result's."""
    in_memory = result.path == Path()
    path = result.path if in_memory else schema.summary_path(result.path)
    summary: dict[str, Any] = {}
    if not in_memory and path.is_file():
        with suppress(ValueError):
            summary = json.loads(path.read_text(encoding="utf-8"))
    if not summary:
        absent.append(f"The summary {path.name or 'of the run'} is not beside the result: notes, stopping criterion, "
                      "memory and the time of writing are not in this report.")
    if "frames" not in summary:
        return summary
    # Of the summary of a series, what it says of the result's frame, as that of a pair says it.
    time = result.attributes[schema.TIME]["deformed"]
    record: Mapping[str, Any] = next((one for one in summary["frames"] if one["time"] == time), {})
    seconds = {"this frame of the series": record["seconds"]} if "seconds" in record else {}
    return {**record, "seconds": seconds, "stop": ""}


Items = list[tuple[str, str]]
"""What is stated, and its value."""

N_WINDOWS = 15
"""Places at which the pattern is looked at, spread over the elements."""

OF_SETUP: Items = [("Specimen", "specimen"), ("Camera", "camera"), ("Lens", "lens"), ("Aperture", "aperture"),
            ("Stand-off distance", "stand_off_distance"), ("Lighting", "lighting"), ("Exposure time", "exposure"),
            ("Image acquisition rate", "image_rate"), ("Patterning technique", "patterning")]
"""What the user alone knows: its name in the report, its key in ``[acquisition]``."""

OF_SCANS: Items = [("Specimen", "specimen"), ("Scanner", "camera"),
                   ("Source: voltage, current, filter", "lighting"),
                   ("Distances of source, specimen and detector", "stand_off_distance"),
                   ("Projections and exposure time", "exposure"), ("Scanning rate", "image_rate"),
                   ("Origin of the texture", "patterning")]
"""The same of volumes."""


def _list_setup(gathered: Gathered) -> Items:
    """List what the case says of the set-up, in its own words; where it says nothing, the key that would."""
    section, shape = gathered.imaging, _parse_size(gathered)
    items = [(name, _quote(gathered, key)) for name, key in (OF_SCANS if gathered.is_of_volumes else OF_SETUP)]
    key, pixel = ("voxel_size", "voxel") if gathered.is_of_volumes else ("pixel_size", "px")
    size, unit = section.get(key), section.get("length_unit", "px")
    scale = view = f"{NOT_STATED}: {gathered.imaging_name}.{key}" if gathered.case else NOT_RECORDED
    if size:
        scale = f"{size:g} {unit} per {pixel} ({1.0 / size:.4g} px per {unit})"
        view = " x ".join(f"{size * side:.4g} {unit}" for side in shape) if shape else NOT_RECORDED
    times = [gathered.get_attribute(schema.TIME, name) for name in ("reference", "deformed")]
    stamps = NOT_RECORDED if None in times else f"{times[0]:g} (reference), {times[1]:g} (deformed)"
    return [*items, ("Image scale", scale), ("Field of view", view), ("Times of the images", stamps)]


def _quote(gathered: Gathered, key: str) -> str:
    """Words of the case about the set-up, or that there are none."""
    missing = f"{NOT_STATED}: acquisition.{key}" if gathered.case else NOT_RECORDED
    return str(gathered.get_section("acquisition").get(key) or missing)


def _parse_size(gathered: Gathered) -> tuple[int, ...]:
    """Width and height of the images, and depth of volumes, pixels; empty where they are not recorded."""
    sizes = str(gathered.get_attribute(schema.PROVENANCE, "reference_size") or "").split("x")
    return tuple(map(int, sizes)) if all(size.isdecimal() for size in sizes) else ()


def _list_images(gathered: Gathered) -> Items:
    """Sizes, grey levels, features and noise of the images, where they still are, and what was done to them."""
    section, shape = gathered.imaging, _parse_size(gathered)
    levels = [(f"Grey levels, {name}", _describe_levels(gathered.images.get(name)))
              for name in ("reference", "deformed")]
    masks = [f"{what} image" for what in ("reference", "deformed") if section.get(f"{what}_mask")]
    masks += ["reference volume"] if section.get("mask") else []
    n_shapes = len(section.get("masked", ()))
    masks += [f"{n_shapes} shapes drawn on the reference image"] if n_shapes else []
    kind, pixels = ("Volume", "voxels") if gathered.is_of_volumes else ("Image", "pixels")
    return [(f"{kind} size", f"{' x '.join(map(str, shape))} px" if shape else NOT_RECORDED), *levels,
            ("Feature size of the pattern", _describe_features(gathered)),
            (f"{kind} noise", _describe_noise(gathered)),
            ("Masks", " and ".join(masks) or "none" if section else NOT_RECORDED),
            (f"Saturated {pixels}", "left out" if section.get("exclude_saturated") else "used"),
            ("Image processing before ddic", _quote(gathered, "processing")),
            ("Image filtering by ddic", _describe_filtering(gathered))]


def _describe_levels(image: ImageSource | None) -> str:
    if image is None:
        return f"{NOT_RECORDED}: the image is not there"
    levels = measure_grey_levels(image)
    saturated = "none can be" if levels.saturation is None else (
        f"{100 * levels.n_saturated / image.extent.n_pixels:.3g} %")
    first = Window.between(image.extent.lower, np.add(image.extent.lower, 1))
    n_bits = image.layout.bits if isinstance(image, ImageFile) else 8 * image.read(first).dtype.itemsize
    return (f"{n_bits} bit, {levels.lowest:g} to {levels.highest:g}, mean {levels.mean:.4g}, "
            f"RMS gradient {math.sqrt(levels.gradient_energy):.3g} per px; saturated: {saturated}")


def _describe_features(gathered: Gathered) -> str:
    if "reference" not in gathered.images:
        return f"{NOT_RECORDED}: the image is not there"
    centres = gathered.result.mesh.centroids
    shown = centres[np.linspace(0, len(centres) - 1, N_WINDOWS).astype(int)]
    width = measure_feature_size(gathered.images["reference"], shown)
    return f"{width:.3g} px (autocorrelation, full width at half maximum)" if math.isfinite(width) else "none found"


def _describe_noise(gathered: Gathered) -> str:
    """Of an image, grey levels."""
    section, residual = gathered.imaging, gathered.last_residual
    measured = gathered.get_attribute(schema.UNCERTAINTY, "noise_grey")
    if measured is not None:
        return f"{measured:.3g} grey levels ({gathered.get_attribute(schema.UNCERTAINTY, 'noise_origin')})"
    if section.get("noise"):
        return f"{section['noise']:g} grey levels (given in the case)"
    if math.isnan(residual):
        return NOT_RECORDED
    rest = (f"{gathered.imaging_name}.at_rest is measured with output.uncertainty = true alone"
            if section.get("at_rest") else "no static pair is recorded")
    of_each = gathered.imaging_name.removesuffix("s")
    return f"{residual / math.sqrt(2.0):.3g} grey levels in each {of_each}, were the residual all noise; {rest}"


def _describe_filtering(gathered: Gathered) -> str:
    """The interpolating spline, and the reference image blurred like the frame."""
    if not gathered.summary:
        return f"{NOT_RECORDED}: only the summary says whether the reference image was blurred like the deformed one"
    blurs = [note for note in gathered.summary.get("notes", ()) if note.startswith(BLUR_NOTE)]
    return "; ".join(["none but the interpolating spline", *blurs])


def list_statements(gathered: Gathered) -> dict[str, Items]:
    """List all that is stated of a measurement, by what stands above it, in the order of the guides.

    How images were taken, what they are like, how they were compared, what it is worth.
    """
    return {
        "Set-up": _list_setup(gathered),
        "Images and pattern": _list_images(gathered),
        "Mesh and formulation": _list_formulation(gathered),
        "Regularisation": _list_regularization(gathered),
        "Convergence": _list_convergence(gathered),
        "Resolution and noise floors": _list_metrology(gathered),
        **_list_material(gathered),
    }


def _list_material(gathered: Gathered) -> dict[str, Items]:
    """List what a simulation and the material's parameters came to, under a heading where there is any."""
    result = gathered.result
    stated: Items = []
    origin = result.attributes.get(schema.COMPARISON, {})
    if origin:
        stated.append(("Simulation", f"{origin['file']}, step {origin['step']}, {origin['placement']}"))
    of_regions = result.compared_regions
    for name, chi, scatter, rms in zip(*(of_regions.get(key, ()) for key in (
            "region", "chi_squared", "scatter", "rms_difference_px")), strict=True):
        stated.append((f"chi^2, {_as_text(name)}", f"{chi:.3g} (1 +- {scatter:.2g} by noise alone), RMS difference "
                                                   f"{rms:.3g} px, the simulation levelled"))
    found = result.identified
    for name, value, deviation, unit, by_fields in zip(*(found.get(key, ()) for key in (
            "parameter", "value", "deviation", "unit", "by_fields")), strict=True):
        of_unit = "" if _as_text(unit) == "1" else f" {_as_text(unit)}"
        stated.append((f"Identified {_as_text(name)}", f"{value:.5g} +- {deviation:.2g}{of_unit} "
                                                       f"(FEMU {by_fields:.5g})"))
    return {"Simulation and material": stated} if stated else {}


def _as_text(value: Any) -> str:
    """A text of a table as HDF5 gives it."""
    return value.decode() if isinstance(value, bytes) else str(value)


def _list_formulation(gathered: Gathered) -> Items:
    """Elements, criterion, interpolation."""
    result, correlation = gathered.result, gathered.get_section("correlation")
    areas, _ = measure_covered_areas(result.mesh)
    technique, shapes, root, pixels = (("DVC", "linear and trilinear", "cube root of the volume", "Voxels")
                                       if gathered.is_of_volumes else
                                       ("DIC", "linear and bilinear", "root of the area", "Pixels"))
    kinds = ", ".join(f"{len(block.cells)} {block.type.name}" for block in result.mesh.cell_blocks)
    sides = areas**(1.0 / result.mesh.dim)
    spread = f"{sides.min():.3g} to {sides.max():.3g} px, mean {sides.mean():.3g} px ({root})"
    n_pixels = result.cell_data.get(schema.RESIDUAL_N_PIXELS)
    counted = NOT_RECORDED if n_pixels is None else f"{n_pixels.min()} to {n_pixels.max()}, mean {n_pixels.mean():.4g}"
    degree = correlation.get("spline_degree")
    return [
        ("Software", f"ddic {gathered.get_attribute(schema.PROVENANCE, 'ddic') or NOT_RECORDED}, commit "
                     f"{gathered.get_attribute(schema.PROVENANCE, 'commit') or NOT_RECORDED}"),
        ("Method", "global DIC by products of functions of x and of y (PGD-DIC)" if result.separated is not None else
                   f"global {technique} by finite elements"),
        ("Shape functions (of a subset: order)", f"{shapes}: {kinds}"),
        ("Element size (subset size and step)", spread),
        ("Unknowns", f"{result.mesh.n_dofs} on {result.mesh.n_nodes} nodes"),
        (f"{pixels} compared per element", counted),
        ("Matching criterion", "sum of squared differences f(x) - g(x + u); grey levels corrected: "
                               f"{_describe_grey(gathered)}"),
        ("Interpolation", f"B-spline of degree {degree}" if degree else NOT_RECORDED),
        ("Discontinuities", str(len(gathered.get_section("discontinuity"))) if gathered.case else NOT_RECORDED),
        ("Excluded elements", _count(result.cell_data.get(schema.EXCLUDED))),
        ("Doubtful elements", _count(result.cell_data.get(schema.DOUBTFUL))),
        ("Strain", "at nodes, recovered from the gradients of the elements around each; infinitesimal, Green-Lagrange, "
                   "logarithmic" if schema.NODAL_HENCKY in result.point_data else "in the middle of elements"),
        ("Strain window", _describe_window(gathered)),
        ("Filtering of displacement and strain", "none after the measurement"),
    ]


def _describe_window(gathered: Gathered) -> str:
    """Elements that make a strain value, and the pixels that these elements' nodes are held by."""
    spacing = find_chain(gathered.result, np.empty(0, np.int64)).spacing
    is_nodal = schema.NODAL_HENCKY in gathered.result.point_data
    n_elements, place = (2, "the elements around a node") if is_nodal else (1, "one element")
    pixels = "voxels" if gathered.is_of_volumes else "pixels"
    # The nodes at the ends of the window take part in elements beyond it.
    return (f"{place}, {n_elements * spacing:.3g} px across; held by {pixels} over "
            f"{(n_elements + 2) * spacing:.3g} px, which subsets call the virtual strain gauge, without regularisation")


def _describe_grey(gathered: Gathered) -> str:
    found, asked = gathered.summary.get("grey_correction"), gathered.get_section("correlation").get("grey_correction")
    names = {"none": "no", "global": "one gain and offset for the image", "element": "gain and offset of each element"}
    return names.get(str(found or asked), str(found or asked or NOT_RECORDED))


def _count(marks: Any) -> str:
    """How many cells are marked."""
    return NOT_RECORDED if marks is None else f"{int(np.count_nonzero(marks))} of {len(marks)}"


def _list_regularization(gathered: Gathered) -> Items:
    """Operator, length, where it does not count."""
    section = gathered.get_section("regularization")
    if not section:
        return [("Operator", "none" if gathered.case else NOT_RECORDED)]
    length, eta = section.get("cut_off_wavelength"), gathered.get_attribute(schema.CASE, "eta")
    shear, longitudinal = (gathered.get_attribute(schema.CASE, f"half_amplitude_{name}_px")
                           for name in ("shear", "longitudinal"))
    of_gap = section.get("operator") == "equilibrium_gap"
    items = [
        ("Operator", f"equilibrium gap (forces out of balance in {_describe_body(section)})" if of_gap else
                     "Tikhonov (gradient of the displacement)"),
        ("Regularisation length", f"cut-off wavelength {length:g} px" if length else "none: the weight is given"),
        ("Weight eta", f"{eta:.4g}" if eta is not None else NOT_RECORDED),
        ("Waves that keep half of their amplitude",
         f"{shear:.4g} px (shear), {longitudinal:.4g} px (longitudinal)" if shear else NOT_RECORDED),
    ]
    if of_gap:
        plane = "" if gathered.is_of_volumes else f", plane {section['plane']}"
        items += [("Material", _describe_material(section, plane)),
                  ("Not controlled", ", ".join(section.get("not_controlled", ())) or "none")]
    return items


def _describe_body(section: Mapping[str, Any]) -> str:
    """What the forces are those of; a case of long ago knows elasticity alone."""
    strain, parts = section.get("yield_strain"), section.get("stiffness") or ()
    body = "an elastic body" if strain is None else (f"a plastic body, yield stress {strain:g} E, hardening "
                                                     f"{section['hardening_ratio']:g} E")
    return body + "".join(f"; {part['region']}: {part['ratio']:g} times as stiff" for part in parts)


def _describe_material(section: Mapping[str, Any], plane: str) -> str:
    """What the equilibrium gap takes the specimen for; a case of long ago knows no composites."""
    nu = section["poisson_ratio"]
    young, shear = section.get("young_ratio", 1.0), section.get("shear_ratio")
    if young == 1.0 and shear is None:
        return f"isotropic, Poisson's ratio {nu:g}{plane}"
    modulus = 1 / (2 * (1 + nu)) if shear is None else shear
    return (f"orthotropic, E1 / E2 = {young:g}, G12 / E2 = {modulus:.4g}, nu12 = {nu:g}, axis 1 at "
            f"{section['material_angle_degrees']:g} degrees from +x to +y{plane}")


def _list_convergence(gathered: Gathered) -> Items:
    """Iterations and what ended them."""
    result, summary = gathered.result, gathered.summary
    is_pgd = result.separated is not None
    table = result.corrections if is_pgd else result.gauss_newton
    count = max((len(column) for column in table.values()), default=0)
    last = [float(size) for size in table.get("rms_correction_px", ())]
    percent = summary.get("residual_percent_of_range")
    share = f" ({percent:.3g} % of the dynamic range)" if percent is not None else ""
    residual = gathered.last_residual
    return [
        ("Status", "converged" if result.converged else f"NOT CONVERGED: {result.failure}"),
        ("Verdict", NOT_RECORDED if result.verdict is None else result.verdict.describe()),
        ("Corrections" if is_pgd else "Gauss-Newton iterations", str(count) if count else NOT_RECORDED),
        ("Last correction", f"{last[-1]:.2g} px RMS" if last else NOT_RECORDED),
        ("Stopped", str(summary.get("stop") or NOT_RECORDED)),
        ("Residual", f"{residual:.4g} grey levels{share}" if math.isfinite(residual) else NOT_RECORDED),
        ("Linear step", str(gathered.get_attribute(schema.PROVENANCE, "method") or NOT_RECORDED)),
        ("Subdomains, ranks", ", ".join(str(gathered.get_attribute(schema.PROVENANCE, name) or NOT_RECORDED)
                                        for name in ("n_subdomains", "n_ranks"))),
    ]


def _list_metrology(gathered: Gathered) -> Items:
    """Of displacement and strain at a node in the middle of the mesh."""
    known, unit = find_field_metrology(gathered), find_length_unit(gathered.result)

    def write_length(value: float) -> str:
        physical = "" if unit.name == "px" else f" = {unit.size * value:.3g} {unit.name}"
        return write_number(value, "{:.3g} px") + (physical if math.isfinite(value) else "")

    return [
        ("Displacement noise floor", write_length(known.displacement_noise)),
        ("Displacement spatial resolution",
         f"{write_length(known.displacement_resolution)} (90 % of a wave's amplitude)"),
        ("Displacement noise x resolution", write_number(known.displacement_indicator, "{:.3g} px²")),
        ("Strain noise floor", write_number(known.strain_noise, "{:.1e}")),
        ("Strain spatial resolution (virtual strain gauge)",
         f"{write_length(known.strain_resolution)} (90 % of a wave's amplitude)"),
        ("Strain noise x resolution squared", write_number(known.strain_indicator, "{:.3g} px²")),
        ("How noise is known", _describe_source(gathered)),
        ("Bias", "not estimated here" if gathered.is_of_volumes else
                 "not estimated here: ddic uncertainty measures known displacements of the reference image"),
    ]


def write_number(value: float, form: str) -> str:
    """Write a number in a form such as ``{:.3g} px``, or that it is not recorded where it is not finite."""
    return form.format(value) if math.isfinite(value) else NOT_RECORDED


def _describe_source(gathered: Gathered) -> str:
    if "sigma_u" in gathered.result.point_data:
        origin = gathered.get_attribute(schema.UNCERTAINTY, "noise_origin") or NOT_RECORDED
        return f"fields of standard deviations, RMS over the nodes; the images' noise: {origin}"
    if math.isfinite(gathered.noise_floor):
        return "estimated from the residual, as if it were all noise; no static pair is recorded"
    return NOT_RECORDED


def find_field_metrology(gathered: Gathered) -> Metrology:
    """Find resolution, of the mesh's mean element size, and noise, of all nodes, of the field as read at nodes."""
    result = gathered.result
    deviations = [result.point_data[name] for name in schema.SIGMA_DISPLACEMENT if name in result.point_data]
    level = math.sqrt(np.nanmean(np.square(deviations))) if deviations else math.nan
    noise = level if math.isfinite(level) else gathered.noise_floor
    # Outside of the mesh: of all its cells.
    outside = PointProbe("field", tuple((result.mesh.nodes.min(axis=0) - 1e3).tolist()))
    return estimate_metrology(result, outside, noise)


N_PLACES = 5
"""Places that are marked; more crowd the picture."""

APART = 0.08
"""Least distance of two of them, relative to the diagonal of the mesh: one bad spot is one place."""

EXCLUDED = {1: "excluded: no texture", 2: "excluded: it shows something else than the reference",
            3: "excluded: too few of its pixels are in both images",
            5: "excluded: masked, or saturated, in the reference image"}


@dataclass(frozen=True, eq=False)
class WorstPlace:
    """A cell with a large residual, the largest about.

    Attributes
    ----------
    number : int
        From 1, the worst.
    position : (dim,) array
        Middle of the cell, pixels.
    residual_rms : float
        Grey levels.
    equivalent_error : float
        Displacement error that would leave this residual, pixels; nan where it is not known.
    verdict : str
        Doubtful, excluded, or nothing to complain about.
    """

    number: int
    position: Array
    residual_rms: float
    equivalent_error: float
    verdict: str


def find_worst_places(result: Result) -> list[WorstPlace]:
    """Find the cells with the largest residual, far from one another; the worst first, at most 5."""
    if schema.RESIDUAL_RMS not in result.cell_data:
        return []
    centres, rms = result.mesh.centroids, result.cell_data[schema.RESIDUAL_RMS]
    nearest = APART * float(np.linalg.norm(np.ptp(result.mesh.nodes, axis=0)))
    chosen: list[int] = []
    for cell in np.argsort(-np.nan_to_num(rms, nan=-1.0), kind="stable"):
        if len(chosen) == N_PLACES or not np.isfinite(rms[cell]):
            break
        if all(np.linalg.norm(centres[cell] - centres[other]) >= nearest for other in chosen):
            chosen.append(int(cell))
    return [_describe(result, number, cell) for number, cell in enumerate(chosen, start=1)]


def _describe(result: Result, number: int, cell: int) -> WorstPlace:
    values = {name: float(of_cells[cell]) for name, of_cells in result.cell_data.items() if of_cells.ndim == 1}
    judged = ("doubtful: the residual is that of a wrong displacement" if values.get(schema.DOUBTFUL) else
              "not doubtful")
    return WorstPlace(number, result.mesh.centroids[cell], values[schema.RESIDUAL_RMS],
                      values.get(schema.EQUIVALENT_ERROR, math.nan),
                      EXCLUDED.get(int(values.get(schema.EXCLUDED, 0)), judged))

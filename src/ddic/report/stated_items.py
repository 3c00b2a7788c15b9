"""What good-practices guides for DIC ask to be stated, with its value or that it is not recorded.

The items are those that the International Digital Image Correlation Society's guide (2018) asks of one camera and a
plane specimen, said for finite elements: an element stands where a subset does. docs/report.md compares them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ddic.io import result_schema as schema
from ddic.mesh.quality import measure_covered_areas
from ddic.plots.canvas import find_length_unit
from ddic.probes.displacement_chain import find_chain
from ddic.probes.metrology import Metrology, estimate_metrology
from ddic.probes.probe_kinds import PointProbe
from ddic.report.gathered import Gathered
from ddic.report.stated_images import list_images, list_setup
from ddic.report.statement import NOT_RECORDED, Items, Statement


def list_statements(gathered: Gathered) -> list[Statement]:
    """List all that is stated of a measurement.

    Parameters
    ----------
    gathered : Gathered
        The result and what belongs to it.

    Returns
    -------
    list of Statement
        In the order of the guides: how images were taken, what they are like, how they were compared, what it is worth.
    """
    return [Statement("Set-up", list_setup(gathered)), Statement("Images and pattern", list_images(gathered)),
            Statement("Mesh and formulation", _list_formulation(gathered)),
            Statement("Regularisation", _list_regularization(gathered)),
            Statement("Convergence", _list_convergence(gathered)),
            Statement("Resolution and noise floors", _list_metrology(gathered))]


def _list_formulation(gathered: Gathered) -> Items:
    """Elements, criterion, interpolation."""
    result, correlation = gathered.result, gathered.get_section("correlation")
    areas, _ = measure_covered_areas(result.mesh)
    kinds = ", ".join(f"{len(block.cells)} {block.type.name}" for block in result.mesh.cell_blocks)
    sides = np.sqrt(areas)
    spread = f"{sides.min():.3g} to {sides.max():.3g} px, mean {sides.mean():.3g} px (root of the area)"
    n_pixels = result.cell_data.get(schema.RESIDUAL_N_PIXELS)
    counted = NOT_RECORDED if n_pixels is None else f"{n_pixels.min()} to {n_pixels.max()}, mean {n_pixels.mean():.4g}"
    degree = correlation.get("spline_degree")
    return [
        ("Software", f"ddic {gathered.get_attribute(schema.PROVENANCE, 'ddic') or NOT_RECORDED}, commit "
                     f"{gathered.get_attribute(schema.PROVENANCE, 'commit') or NOT_RECORDED}"),
        ("Method", "global DIC by products of functions of x and of y (PGD-DIC)" if result.separated is not None else
                   "global DIC by finite elements"),
        ("Shape functions (of a subset: order)", f"linear and bilinear: {kinds}"),
        ("Element size (subset size and step)", spread),
        ("Unknowns", f"{result.mesh.n_dofs} on {result.mesh.n_nodes} nodes"),
        ("Pixels compared per element", counted),
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
    # The nodes at the ends of the window take part in elements beyond it.
    return (f"{place}, {n_elements * spacing:.3g} px across; held by pixels over {(n_elements + 2) * spacing:.3g} px, "
            "which subsets call the virtual strain gauge, without regularisation")


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
        ("Operator", "equilibrium gap (forces out of balance in an elastic body)" if of_gap else
                     "Tikhonov (gradient of the displacement)"),
        ("Regularisation length", f"cut-off wavelength {length:g} px" if length else "none: the weight is given"),
        ("Weight eta", f"{eta:.4g}" if eta is not None else NOT_RECORDED),
        ("Waves that keep half of their amplitude",
         f"{shear:.4g} px (shear), {longitudinal:.4g} px (longitudinal)" if shear else NOT_RECORDED),
    ]
    if of_gap:
        items += [("Material", f"isotropic, Poisson's ratio {section.get('poisson_ratio'):g}, plane "
                               f"{section.get('plane')}"),
                  ("Not controlled", ", ".join(section.get("not_controlled", ())) or "none")]
    return items


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

    def write(value: float, in_length: bool = True) -> str:
        if not math.isfinite(value):
            return NOT_RECORDED
        if not in_length:
            return f"{value:.1e}"
        physical = "" if unit.name == "px" else f" = {unit.size * value:.3g} {unit.name}"
        return f"{value:.3g} px{physical}"

    bias = "not estimated here: `ddic uncertainty` measures known displacements of the reference image"
    return [
        ("Displacement noise floor", write(known.displacement_noise)),
        ("Displacement spatial resolution", f"{write(known.displacement_resolution)} (90 % of a wave's amplitude)"),
        ("Displacement noise x resolution", _write_area(known.displacement_indicator)),
        ("Strain noise floor", write(known.strain_noise, in_length=False)),
        ("Strain spatial resolution (virtual strain gauge)", f"{write(known.strain_resolution)} (90 % of a wave's "
                                                             "amplitude)"),
        ("Strain noise x resolution squared", _write_area(known.strain_indicator)),
        ("How noise is known", _describe_source(gathered)),
        ("Bias", bias.replace("`", "")),
    ]


def _write_area(value: float) -> str:
    return f"{value:.3g} px²" if math.isfinite(value) else NOT_RECORDED


def _describe_source(gathered: Gathered) -> str:
    if "sigma_u" in gathered.result.point_data:
        origin = gathered.get_attribute(schema.UNCERTAINTY, "noise_origin") or NOT_RECORDED
        return f"fields of standard deviations, RMS over the nodes; the images' noise: {origin}"
    if math.isfinite(gathered.noise_floor):
        return "estimated from the residual, as if it were all noise; no static pair is recorded"
    return NOT_RECORDED


def find_field_metrology(gathered: Gathered) -> Metrology:
    """Find resolution and noise of the field as it is, read at nodes.

    Parameters
    ----------
    gathered : Gathered
        The result and what belongs to it.

    Returns
    -------
    Metrology
        With the mean element size of the mesh; the noise is that of all nodes.
    """
    result = gathered.result
    level = _find_mean_level([result.point_data[name] for name in ("sigma_u", "sigma_v") if name in result.point_data])
    noise = level if math.isfinite(level) else gathered.noise_floor
    # Outside of the mesh: of all its cells.
    outside = PointProbe("field", (float(result.mesh.nodes[:, 0].min()) - 1e3, 0.0))
    return estimate_metrology(result, outside, noise)


def _find_mean_level(fields: Sequence[Any]) -> float:
    return float(np.sqrt(np.nanmean(np.square(fields)))) if len(fields) else math.nan

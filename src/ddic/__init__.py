"""Finite element digital image correlation by dual domain decomposition.

``ddic.measure`` measures the displacement between two images, ``ddic.prepare`` prepares a reference image for many
deformed ones, ``ddic.open`` reads a result file, ``ddic.open_series`` that of a series.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from ddic.version import __version__

if TYPE_CHECKING:
    from ddic.api.given import Image
    from ddic.api.measure import Session, measure, prepare
    from ddic.api.studies import Uncertainty, choose_regularization, estimate_uncertainty, identify
    from ddic.api.synthetic import make_synthetic_pair
    from ddic.case.loader import load_case
    from ddic.case.schema import Case
    from ddic.errors import ConvergenceError, DdicError, FactorizationError, InputError, SingularSubdomainError
    from ddic.fracture.crack_tip import CrackTip, Ring, TipDeviations, find_crack_tip
    from ddic.fracture.opening import Opening, measure_opening
    from ddic.io.result_reader import Result
    from ddic.io.result_reader import read_result as open
    from ddic.io.series_reader import SeriesResult
    from ddic.io.series_reader import read_series as open_series
    from ddic.kinematics.kinematics import Kinematics, RegionKinematics
    from ddic.kinematics.linear import LinearRegion
    from ddic.kinematics.nodal import NodalRegion
    from ddic.mesh.mesh import Mesh
    from ddic.mesh.structured import build_structured_mesh as structured_mesh
    from ddic.mesh.unstructured import build_unstructured_mesh as unstructured_mesh
    from ddic.probes.metrology import Metrology, estimate_metrology
    from ddic.probes.probes import Extensometer, LineProbe, PointProbe, Reading, StrainGauge, load_probes, measure_probe
    from ddic.probes.tables import measure_probes, write_field_tables, write_probe_table
    from ddic.report.page import write_report
    from ddic.results.sweep import Candidate, Sweep, Trial

_PUBLIC = {
    "api.given": ("Image",),
    "api.measure": ("Session", "measure", "prepare"),
    "api.studies": ("Uncertainty", "choose_regularization", "estimate_uncertainty", "identify"),
    "api.synthetic": ("make_synthetic_pair",),
    "case.loader": ("load_case",),
    "case.schema": ("Case",),
    "errors": ("ConvergenceError", "DdicError", "FactorizationError", "InputError", "SingularSubdomainError"),
    "fracture.crack_tip": ("CrackTip", "Ring", "TipDeviations", "find_crack_tip"),
    "fracture.opening": ("Opening", "measure_opening"),
    "io.result_reader": ("Result", "open"),
    "io.series_reader": ("SeriesResult", "open_series"),
    "kinematics.kinematics": ("Kinematics", "RegionKinematics"),
    "kinematics.linear": ("LinearRegion",),
    "kinematics.nodal": ("NodalRegion",),
    "mesh.mesh": ("Mesh",),
    "mesh.structured": ("structured_mesh",),
    "mesh.unstructured": ("unstructured_mesh",),
    "page": ("draw", "view_results"),
    "probes.metrology": ("Metrology", "estimate_metrology"),
    "probes.probes": ("Extensometer", "LineProbe", "PointProbe", "Reading", "StrainGauge", "load_probes",
                      "measure_probe"),
    "probes.tables": ("measure_probes", "write_field_tables", "write_probe_table"),
    "report.page": ("write_report",),
    "results.sweep": ("Candidate", "Sweep", "Trial"),
}
"""Where the public names live: modules are imported at first use, for some bring MPI, PETSc and numba."""

_HOMES = {name: home for home, names in _PUBLIC.items() for name in names}

_NAMED_THERE = {"draw": "draw_case", "open": "read_result", "open_series": "read_series",
                "structured_mesh": "build_structured_mesh", "unstructured_mesh": "build_unstructured_mesh"}
"""What names are called at home, where they differ."""

__all__ = [
    "Candidate", "Case", "ConvergenceError", "CrackTip", "DdicError", "Extensometer", "FactorizationError", "Image",
    "InputError", "Kinematics", "LineProbe", "LinearRegion", "Mesh", "Metrology", "NodalRegion", "Opening",
    "PointProbe", "Reading", "RegionKinematics", "Result", "Ring", "SeriesResult", "Session",
    "SingularSubdomainError", "StrainGauge", "Sweep", "TipDeviations", "Trial", "Uncertainty", "__version__",
    "choose_regularization", "draw", "estimate_metrology", "estimate_uncertainty", "find_crack_tip", "identify",
    "load_case", "load_probes", "make_synthetic_pair", "measure", "measure_opening", "measure_probe", "measure_probes",
    "open", "open_series", "prepare", "structured_mesh", "unstructured_mesh", "view_results", "write_field_tables",
    "write_probe_table", "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'ddic' has no attribute '{name}'")
    module = importlib.import_module(f"ddic.{_HOMES[name]}")
    return getattr(module, _NAMED_THERE.get(name, name))


def __dir__() -> list[str]:
    return sorted(__all__)

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
    from ddic.api.options import Options
    from ddic.api.studies import Uncertainty, choose_regularization, estimate_uncertainty
    from ddic.api.synthetic import make_synthetic_pair
    from ddic.case.loader import load_case
    from ddic.case.schema import Case
    from ddic.errors import ConvergenceError, DdicError, FactorizationError, InputError, SingularSubdomainError
    from ddic.fracture.crack_tip import CrackTip, Ring, find_crack_tip
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
    from ddic.probes.metrology import Metrology, estimate_metrology
    from ddic.probes.probes import Extensometer, LineProbe, PointProbe, StrainGauge, load_probes
    from ddic.probes.read_probe import Reading, measure_probe
    from ddic.probes.tables import measure_probes, write_field_tables, write_probe_table
    from ddic.report.page import write_report
    from ddic.results.sweep import Candidate, Sweep, Trial

_HOMES = {
    "choose_regularization": "api.studies",
    "Image": "api.given",
    "Options": "api.options",
    "Session": "api.measure",
    "measure": "api.measure",
    "prepare": "api.measure",
    "make_synthetic_pair": "api.synthetic",
    "Uncertainty": "api.studies",
    "estimate_uncertainty": "api.studies",
    "load_case": "case.loader",
    "Case": "case.schema",
    "ConvergenceError": "errors",
    "DdicError": "errors",
    "FactorizationError": "errors",
    "InputError": "errors",
    "SingularSubdomainError": "errors",
    "CrackTip": "fracture.crack_tip",
    "Ring": "fracture.crack_tip",
    "find_crack_tip": "fracture.crack_tip",
    "Opening": "fracture.opening",
    "measure_opening": "fracture.opening",
    "Result": "io.result_reader",
    "open": "io.result_reader:read_result",
    "SeriesResult": "io.series_reader",
    "open_series": "io.series_reader:read_series",
    "Kinematics": "kinematics.kinematics",
    "RegionKinematics": "kinematics.kinematics",
    "LinearRegion": "kinematics.linear",
    "NodalRegion": "kinematics.nodal",
    "Mesh": "mesh.mesh",
    "Candidate": "results.sweep",
    "Sweep": "results.sweep",
    "Trial": "results.sweep",
    "structured_mesh": "mesh.structured:build_structured_mesh",
    "Extensometer": "probes.probes",
    "LineProbe": "probes.probes",
    "PointProbe": "probes.probes",
    "StrainGauge": "probes.probes",
    "Reading": "probes.read_probe",
    "measure_probe": "probes.read_probe",
    "Metrology": "probes.metrology",
    "estimate_metrology": "probes.metrology",
    "load_probes": "probes.probes",
    "measure_probes": "probes.tables",
    "write_probe_table": "probes.tables",
    "write_field_tables": "probes.tables",
    "write_report": "report.page",
}
"""Where the public names live: modules are imported at first use, for some bring MPI, PETSc and numba."""

__all__ = [
    "Candidate",
    "Case",
    "ConvergenceError",
    "CrackTip",
    "DdicError",
    "Extensometer",
    "FactorizationError",
    "Image",
    "InputError",
    "Kinematics",
    "LineProbe",
    "LinearRegion",
    "Mesh",
    "Metrology",
    "NodalRegion",
    "Opening",
    "Options",
    "PointProbe",
    "Reading",
    "RegionKinematics",
    "Result",
    "Ring",
    "SeriesResult",
    "Session",
    "SingularSubdomainError",
    "StrainGauge",
    "Sweep",
    "Trial",
    "Uncertainty",
    "__version__",
    "choose_regularization",
    "estimate_metrology",
    "estimate_uncertainty",
    "find_crack_tip",
    "load_case",
    "load_probes",
    "make_synthetic_pair",
    "measure",
    "measure_opening",
    "measure_probe",
    "measure_probes",
    "open",
    "open_series",
    "prepare",
    "structured_mesh",
    "write_field_tables",
    "write_probe_table",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'ddic' has no attribute '{name}'")
    home, _, other_name = _HOMES[name].partition(":")
    return getattr(importlib.import_module(f"ddic.{home}"), other_name or name)


def __dir__() -> list[str]:
    return sorted(__all__)

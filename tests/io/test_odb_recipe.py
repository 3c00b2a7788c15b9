"""The recipe for Abaqus' .odb: what it writes of a recorded structure is read as any other simulation."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ddic.errors import InputError
from ddic.io.simulations.simulation_file import list_steps, read_simulation
from ddic.mesh.interpolation import interpolate
from ddic.mesh.mesh import Similarity

RECIPE = Path(__file__).parents[2] / "scripts" / "odb_to_vtk.py"


@pytest.fixture
def recipe() -> Any:
    spec = importlib.util.spec_from_file_location("odb_to_vtk", RECIPE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class _Values:
    """A field output of Abaqus: values by node label, of an instance."""

    def __init__(self, values: list[Any]) -> None:
        self.values = values

    def getSubset(self, region: object) -> _Values:
        assert region is not None
        return self


def _make_odb(element: str = "CPS8R", precision: str = "SINGLE_PRECISION") -> Any:
    """Two quadratic squares side by side, labels from 11, two steps of which the first has two frames."""
    corners, sides = [(0, 0), (4, 0), (8, 0), (0, 4), (4, 4), (8, 4)], [(2, 0), (6, 0), (0, 2), (4, 2), (8, 2), (2, 4)]
    points = dict(enumerate([*corners, *sides, (6, 4)], start=11))
    cells = [(11, 12, 15, 14, 17, 20, 22, 19), (12, 13, 16, 15, 18, 21, 23, 20)]

    field = "data" if precision == "SINGLE_PRECISION" else "dataDouble"

    def frame(time: float, stretch: float) -> Any:
        values = [SimpleNamespace(nodeLabel=label, precision=precision,
                                  **{field: np.array([stretch * x, -0.3 * stretch * y], np.float32)})
                  for label, (x, y) in points.items()]
        return SimpleNamespace(frameValue=time, fieldOutputs={"U": _Values(values), "S": None})

    instance = SimpleNamespace(nodes=[SimpleNamespace(label=label, coordinates=(x, y, 0.0))
                                      for label, (x, y) in points.items()],
                               elements=[SimpleNamespace(type=element, connectivity=labels) for labels in cells])
    steps = {"load": SimpleNamespace(frames=[frame(0.0, 0.0), frame(1.0, 0.01)], timePeriod=1.0),
             "more": SimpleNamespace(frames=[frame(0.5, 0.02)], timePeriod=0.5)}
    return SimpleNamespace(rootAssembly=SimpleNamespace(instances={"STRIP-1": instance}), steps=steps)


@pytest.mark.parametrize("precision", ["SINGLE_PRECISION", "DOUBLE_PRECISION"])
def test_what_it_writes_is_read_by_step_and_time(tmp_path: Path, recipe: Any, precision: str) -> None:
    recipe.write_frames(_make_odb(precision=precision), None, str(tmp_path / "job"))
    path = tmp_path / "job.pvd"
    assert [(step.number, step.time) for step in list_steps(path)] == [(1, 0.0), (2, 1.0), (3, 1.5)]
    for chosen, stretch in (({"step": 2}, 0.01), ({"time": 1.5}, 0.02), ({"step": -1}, 0.02)):
        read = read_simulation(path, Similarity(), 2, **chosen)
        points = np.array([[1.0, 1.0], [5.5, 3.0]])
        # Single precision there.
        np.testing.assert_allclose(interpolate(read.mesh, read.displacement, points),
                                   points * [stretch, -0.3 * stretch], rtol=1e-6)


def test_a_node_without_displacement_is_named(tmp_path: Path, recipe: Any) -> None:
    odb = _make_odb()
    for step in odb.steps.values():
        for frame in step.frames:
            del frame.fieldOutputs["U"].values[3]
    recipe.write_frames(odb, None, str(tmp_path / "job"))
    with pytest.raises(InputError, match="have no displacement in step"):
        read_simulation(tmp_path / "job.pvd", Similarity(), 2, step=2)


def test_an_unknown_element_is_told(tmp_path: Path, recipe: Any) -> None:
    with pytest.raises(SystemExit, match="element CAX4 is not known here"):
        recipe.write_frames(_make_odb("CAX4"), None, str(tmp_path / "job"))

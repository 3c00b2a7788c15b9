"""``ddic.identify`` with a model of one's own: as the built-in law, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

import ddic
from ddic.arrays import Array
from ddic.errors import InputError
from ddic.synth.fields import Affine
from ddic.synth.render import Digitiser, Picture, Scene, render_pair
from ddic.synth.speckle import SpeckleTexture

FIELD = Affine(((-0.003, 0.0), (0.0, 0.01)), (0.4, 0.3), (64.0, 64.0))

CASE = """
[images]
reference = "f.tif"
deformed = "g.tif"
[mesh.structured]
region = [16, 16, 112, 112]
element_size = 16
"""


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plate")
    pair = render_pair(Scene(SpeckleTexture(3), FIELD), Picture(129, 129, Digitiser(8, 1.0)))
    tifffile.imwrite(folder / "f.tif", pair.reference)
    tifffile.imwrite(folder / "g.tif", pair.deformed)
    (folder / "case.toml").write_text(CASE)
    return folder / "case.toml"


def _stretch(mesh: ddic.Mesh, parameters: Array) -> Array:
    nu, strain, x, y = parameters
    return np.asarray((mesh.nodes - 64.0) * [-nu * strain, strain] + [x, y])


START = {"nu": 0.2, "strain": 0.008, "x": 0.0, "y": 0.0}


def test_a_function_of_the_mesh_is_fitted_to_the_images(case: Path) -> None:
    table = ddic.identify(case, _stretch, START).identified
    assert [name.decode() for name in table["parameter"]] == list(START)
    true = np.array([0.3, 0.01, 0.4, 0.3])
    assert (np.abs(table["value"] - true) < 4.0 * table["deviation"]).all()
    # The field is linear: elements of half the size say the same, and FEMU does.
    assert (np.abs(table["by_halving"]) < 0.05 * table["deviation"]).all()
    assert (np.abs(table["by_fields"] - table["value"]) < 0.2 * table["deviation"]).all()


def test_derivatives_that_are_given_do_what_differences_do(case: Path) -> None:
    def with_slopes(mesh: ddic.Mesh, parameters: Array) -> tuple[Array, Array]:
        (nu, strain, _, _), (x, y) = parameters, (mesh.nodes - 64.0).T
        zero, one = np.zeros_like(x), np.ones_like(x)
        slopes = [(-strain * x, zero), (-nu * x, y), (one, zero), (zero, one)]
        return _stretch(mesh, parameters), np.stack([np.column_stack(of_one) for of_one in slopes])

    given, differences = (ddic.identify(case, model, START).identified for model in (with_slopes, _stretch))
    # The model is bilinear: central differences are exact but for rounding.
    np.testing.assert_allclose(given["value"], differences["value"], rtol=1e-9)
    np.testing.assert_allclose(given["deviation"], differences["deviation"], rtol=1e-6)


def test_a_rotation_is_the_models_own(tmp_path: Path) -> None:
    """Three degrees: the regularization and built-in laws take them off, a model of one's own holds them."""
    turn = np.deg2rad(3.0)
    matrix = np.array([[np.cos(turn) * 1.01 - 1, -np.sin(turn)], [np.sin(turn) * 1.01, np.cos(turn) - 1]])
    pair = render_pair(Scene(SpeckleTexture(3), Affine(tuple(map(tuple, matrix.tolist())), (0.2, 0.1), (64.0, 64.0))),
                       Picture(129, 129, Digitiser(8, 1.0)))
    tifffile.imwrite(tmp_path / "f.tif", pair.reference)
    tifffile.imwrite(tmp_path / "g.tif", pair.deformed)
    (tmp_path / "case.toml").write_text(CASE)
    filled = []

    def simulate(mesh: ddic.Mesh, parameters: Array) -> Array:
        angle, strain, x, y = parameters
        rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        if not filled or len(filled[0]) != mesh.n_nodes:
            filled[:] = [np.zeros((mesh.n_nodes, 2))]
        # One place that is filled again and again.
        filled[0][:] = (mesh.nodes - 64.0) @ (rotation @ np.diag([1.0 + strain, 1.0]) - np.eye(2)).T + [x, y]
        return np.asarray(filled[0])

    start = {"angle": 0.04, "strain": 0.0, "x": 0.0, "y": 0.0}
    table = ddic.identify(tmp_path / "case.toml", simulate, start).identified
    assert (np.abs(table["value"] - [turn, 0.01, 0.2, 0.1]) < 4.0 * table["deviation"]).all()
    assert [unit.decode() for unit in table["unit"]] == ["1"] * 4


def test_wrong_models_are_told(case: Path) -> None:
    with pytest.raises(InputError, match="simulate and start go together"):
        ddic.identify(case, _stretch)
    with pytest.raises(InputError, match=r"simulate gave an array of shape \(3,\)"):
        ddic.identify(case, lambda mesh, parameters: np.zeros(3), START)
    with pytest.raises(InputError, match=r"simulate gave an array of shape \(2, 49\)"):
        ddic.identify(case, lambda mesh, parameters: _stretch(mesh, parameters).T, START)
    with pytest.raises(InputError, match="identification: idle moves no node"):
        ddic.identify(case, lambda mesh, parameters: _stretch(mesh, parameters[:4]), {**START, "idle": 1.0})
    for start, told in (({"E1/E2": 1.0}, "is no name"), ({"nu": float("nan")}, "is no finite number")):
        with pytest.raises(InputError, match=told):
            ddic.identify(case, _stretch, start)
    with pytest.raises(InputError, match="step = 0: it must be above 0"):
        ddic.identify(case, _stretch, START, step=0)
    with pytest.raises(InputError, match="identification: this section is missing"):
        ddic.identify(case)

"""Stiffness of laws by the operator that regularizes, and its derivatives by differences."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.functionals.regularization import Material, assemble_stiffness
from ddic.identification.laws import ElasticBody, ElasticLaw, LawOnCells
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import build_structured_mesh

LAWS = {
    "plane stress": (ElasticLaw(), [1.0, 0.3], Material(0.3)),
    "plane strain": (ElasticLaw(plane="strain"), [1.0, 0.3], Material(0.3, "strain")),
    "orthotropic": (ElasticLaw("orthotropic"), [5.0, 1.0, 0.28, 0.6, 30.0],
                    Material(0.28, "stress", 5.0, 0.6, np.deg2rad(30.0))),
}


def _mesh(cell: str) -> Mesh:
    return build_structured_mesh((0.0, 0.0, 40.0, 32.0), 8.0, cell, circles=[((20.0, 16.0), 5.0)])


def _body(mesh: Mesh, law: ElasticLaw, values: list[float]) -> ElasticBody:
    everywhere = np.ones(mesh.n_cells, dtype=bool)
    return ElasticBody(mesh, [LawOnCells(law, everywhere, np.array(values), np.ones(len(values), dtype=bool))])


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("cell", ["Q4", "T3"])
def test_the_stiffness_is_that_of_the_operator(name: str, cell: str) -> None:
    law, values, material = LAWS[name]
    mesh = _mesh(cell)
    difference = _body(mesh, law, values).assemble_stiffness(np.array(values)) - assemble_stiffness(mesh, material)
    assert abs(difference).max() < 1e-14 * 5.0


@pytest.mark.parametrize("name", LAWS)
def test_derivatives_are_those_of_differences(name: str) -> None:
    law, values, _ = LAWS[name]
    body, p = _body(_mesh("Q4"), law, values), np.array(values)
    for k, derivative in enumerate(body.differentiate_stiffness(p)):
        # Error of the difference: its square, relative.
        step = 1e-4 * p[k] * np.eye(len(p))[k]
        change = (body.assemble_stiffness(p + step) - body.assemble_stiffness(p - step)) / (2.0 * step[k])
        assert abs(change - derivative).max() < 1e-6 * abs(derivative).max()


def test_cells_have_laws_of_their_own_and_fixed_parameters_stay() -> None:
    mesh = _mesh("Q4")
    is_left = mesh.centroids[:, 0] < 20.0
    law = ElasticLaw()
    body = ElasticBody(mesh, [
        LawOnCells(law, is_left, np.array([2.0, 0.1]), np.array([True, False]), "left"),
        LawOnCells(law, ~is_left, np.array([1.0, 0.3]), np.array([True, True]), "rest")])
    assert body.names == ["left.young", "rest.young", "rest.poisson_ratio"]
    assert body.start.tolist() == [2.0, 1.0, 0.3]
    parts = [_body(mesh, law, values) for values in ([1.0, 0.1], [1.0, 0.3])]
    whole = body.assemble_stiffness(np.array([4.0, 3.0, 0.3]))
    # Nodes that only cells of one law have.
    alone = np.repeat(mesh.nodes[:, 0] < 10.0, 2)
    assert abs((whole - 4.0 * parts[0].assemble_stiffness(np.array([1.0, 0.1])))[alone]).max() < 1e-13


@pytest.mark.parametrize(("law", "values", "is_possible"), [
    (ElasticLaw(), [1.0, 0.49], True), (ElasticLaw(), [1.0, 0.6], False), (ElasticLaw(), [-1.0, 0.3], False),
    (ElasticLaw("orthotropic"), [4.0, 1.0, 1.9, 0.5, 0.0], True),
    (ElasticLaw("orthotropic"), [4.0, 1.0, 2.1, 0.5, 0.0], False),
    (ElasticLaw("orthotropic"), [4.0, 1.0, 0.3, -0.5, 0.0], False),
])
def test_what_no_material_is(law: ElasticLaw, values: list[float], *, is_possible: bool) -> None:
    assert law.is_possible(np.array(values)) is is_possible

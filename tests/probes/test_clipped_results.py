"""Probes look at the cells about them alone: what they read is that of the whole result, to the last bit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import ddic
from ddic.io import result_schema as schema
from ddic.io.result_reader import Result, clip_result
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.mesh import Mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.probes import metrology
from ddic.probes.metrology import estimate_metrology
from ddic.probes.probes import Measure, Probe
from ddic.probes.tables import measure_probes
from ddic.separated.field import SeparatedField
from support.random_meshes import grid_mesh
from support.separated import lines

Array = NDArray[np.float64]
SIDE = 120.0
CASES = ("mixed cells", "hole", "fine and coarse", "discontinuity", "excluded", "separated", "eta")


def known(mesh: Mesh, **more: object) -> Result:
    """A result with numbers that no rule makes, so that another cell or node would be seen."""
    random = np.random.default_rng(mesh.n_cells)
    u = random.normal(0.0, 1.0, (mesh.n_nodes, 2))
    at_nodes = {name: np.column_stack([random.normal(0.0, 0.01, (mesh.n_nodes, 2)), np.zeros(mesh.n_nodes),
                                       random.normal(0.0, 0.01, mesh.n_nodes), np.zeros((mesh.n_nodes, 2))])
                for name in (schema.NODAL_INFINITESIMAL, schema.NODAL_GREEN_LAGRANGE, schema.NODAL_HENCKY)}
    for name in (*schema.SIGMA_DISPLACEMENT[:2], *schema.list_sigma_strains(2)[:2]):
        at_nodes[name] = random.uniform(0.01, 0.02, mesh.n_nodes)
    at_nodes[schema.DISPLACEMENT] = np.pad(u, ((0, 0), (0, 1)))
    on_cells = {schema.DOUBTFUL: (random.random(mesh.n_cells) < 0.1).astype(np.uint8)}
    attributes = {schema.CASE: {"half_amplitude_shear_px": 40.0, "half_amplitude_longitudinal_px": 50.0,
                                "json": '{"regularization": {"cut_off_wavelength": 60}}'}}
    return replace(Result(Path("known.vtkhdf"), mesh, u, at_nodes, on_cells, np.zeros(mesh.n_cells, np.int64), {}, (),
                          attributes, False), **more)


@cache
def make(case: str) -> Result:
    square = (0.0, 0.0, SIDE, SIDE)
    plain = build_structured_mesh(square, 8.0)
    meshes = {
        "mixed cells": grid_mesh(15, 15, (8.0, 8.0), cells="mixed", jitter=0.2),
        "hole": build_structured_mesh(square, 8.0, "T3", circles=[((60.0, 60.0), 25.0)]),
        # Spacing changes over the mesh: its mean is another one than that of the cells about a probe.
        "fine and coarse": replace(plain, nodes=SIDE * (plain.nodes / SIDE)**2),
    }
    if case in meshes:
        return known(meshes[case])
    if case == "discontinuity":
        line = np.array([[-5.0, 33.0], [70.3, 61.7]])
        mesh = cut_mesh(plain, [line]).mesh
        sections = '{"discontinuity": [{"vertices": [[-5.0, 33.0], [70.3, 61.7]]}]}'
        return known(mesh, attributes={schema.CASE: {"json": sections, schema.NOISE_FLOOR: 0.01}})
    if case == "separated":
        along_x, along_y = lines(square, 8.0)
        random = np.random.default_rng(1)
        field = SeparatedField(along_x, along_y, random.normal(size=(3, 2)),
                               random.normal(size=(3, 2, along_x.n_nodes)), random.normal(size=(3, 2, along_y.n_nodes)))
        return known(plain, separated=field)
    result = known(plain)
    if case == "excluded":
        # Nodes whose cells all were excluded.
        unknown = np.linalg.norm(result.mesh.nodes - [40.0, 80.0], axis=1) < 20.0
        displacement = np.where(unknown[:, None], np.nan, result.displacement)
        return replace(result, displacement=displacement)
    return replace(result, attributes={schema.CASE: {"json": '{"regularization": {"eta": 1.0}}'}})


def same(one: object, other: object) -> bool:
    """Equal to the last bit, nan where nan is."""
    for field in fields(one):  # type: ignore[arg-type]
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, str) or field.name == "probe":
            if a != b:
                return False
        elif not np.array_equal(a, b, equal_nan=True):
            return False
    return True


# Nodes, edges and places beside the mesh are more frequent than chance would have them.
coordinate = st.one_of(st.floats(-30, 150), st.integers(-4, 19).map(lambda n: 8.0 * n),
                       st.sampled_from([-5e-7, -2e-6, SIDE + 5e-7, SIDE + 2e-6]))
place = st.tuples(coordinate, coordinate)
ends = st.tuples(place, place).filter(lambda both: math.dist(*both) > 1.0)
probes = st.one_of(
    st.builds(lambda at: ddic.PointProbe("p", at), place),
    st.builds(lambda both, spacing: ddic.LineProbe("l", *both, spacing=spacing), ends, st.floats(0.5, 20)),
    st.builds(lambda both: ddic.Extensometer("e", *both), ends),
    st.builds(lambda at, length, angle: ddic.StrainGauge("g", at, length, angle=angle), place, st.floats(2, 60),
              st.sampled_from([0.0, 30.0, 90.0, -117.3])))


@pytest.fixture(scope="module")
def few_waves() -> Iterator[None]:
    """Noise and resolution from few waves: they are to be equal, not right."""
    kept = (metrology._find_displacement_noise, metrology.find_strain_noise, metrology.find_displacement_resolution,
            metrology.find_strain_resolution)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(metrology, "N_WAVES", 16)
        for function in kept:
            function.cache_clear()
        yield
        for function in kept:
            function.cache_clear()


@pytest.mark.usefixtures("few_waves")
@pytest.mark.parametrize("case", CASES)
@given(probe=probes, measure=st.sampled_from(["infinitesimal", "green-lagrange", "hencky"]))
@settings(max_examples=30)
def test_probes_read_the_same_on_the_cells_about_them(case: str, probe: Probe, measure: Measure) -> None:
    result = make(case)
    record, = measure_probes([result], [probe], measure)
    assert same(record.reading, ddic.measure_probe(result, probe, measure))
    assert same(record.metrology, estimate_metrology(result, probe))


def test_a_line_that_passes_a_corner_has_the_spacing_of_the_whole_mesh() -> None:
    """Its box touches a cell, but no place of it lies in one: resolution and noise are those of all cells."""
    result = make("fine and coarse")
    probe = ddic.Extensometer("e", (110.0, -20.0), (140.0, 10.0))
    record, = measure_probes([result], [probe])
    assert record.reading.note == "2 of 2 places outside the mesh or in a hole"
    assert same(record.metrology, estimate_metrology(result, probe))
    assert not math.isnan(record.metrology.strain_resolution)


def test_the_cells_that_touch_a_box_are_kept_with_their_fields() -> None:
    result = make("hole")
    clipped = clip_result(result, np.array([10.0, 10.0]), np.array([20.0, 30.0]))
    # Three columns and four rows of squares in halves; their corners at 8 and 24, 8 and 32.
    assert clipped.mesh.n_cells < 40
    assert clipped.mesh.nodes.min(axis=0).tolist() == [8.0, 8.0]
    assert clipped.mesh.nodes.max(axis=0).tolist() == [24.0, 32.0]
    at = {tuple(node): number for number, node in enumerate(result.mesh.nodes.tolist())}
    rows = [at[tuple(node)] for node in clipped.mesh.nodes.tolist()]
    for name, values in clipped.point_data.items():
        np.testing.assert_array_equal(values, result.point_data[name][rows])
    np.testing.assert_array_equal(clipped.displacement, result.displacement[rows])
    beside = clip_result(result, np.array([500.0, 10.0]), np.array([520.0, 30.0]))
    assert beside is result

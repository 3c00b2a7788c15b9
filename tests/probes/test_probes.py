"""What probes read on fields that are known."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import ddic
from ddic.errors import InputError
from probes.conftest import MakeResult

Array = NDArray[np.float64]
GRADIENT = np.array([[0.004, -0.002], [0.001, -0.003]])
SHIFT = np.array([1.3, -0.4])


def linear(points: Array) -> Array:
    return np.asarray(SHIFT + points @ GRADIENT.T)


def turn(angle: float, stretch: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]]) @ np.diag([1.0 + stretch, 1.0])


@pytest.mark.parametrize("angle", [0.0, 30.0, -117.0])
def test_gauge_is_exact_on_linear_fields_in_any_direction(make_result: MakeResult, angle: float) -> None:
    reading = ddic.measure_probe(make_result(linear), ddic.StrainGauge("g", (61.3, 80.1), 40, width=25, angle=angle))
    expected = 0.5 * (GRADIENT + GRADIENT.T)
    # Rounding of sums over a thousand samples.
    np.testing.assert_allclose(reading.strain[0], expected[[0, 1, 0], [0, 1, 1]], atol=1e-13)
    np.testing.assert_allclose(reading.displacement[0], linear(np.array([[61.3, 80.1]]))[0], atol=1e-12)
    e = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
    assert reading.along[0] == pytest.approx(np.linalg.norm((np.eye(2) + GRADIENT) @ e) - 1.0, abs=1e-13)
    assert reading.note == ""


def test_gauge_on_a_quadratic_field_reads_the_slope_in_its_middle(make_result: MakeResult) -> None:
    """The curvature adds nothing to a plane that fits over a rectangle about the middle, nor do cells about a node."""
    def quadratic(points: Array) -> Array:
        x, y = (points - [80.0, 60.0]).T
        return np.column_stack([1e-4 * x**2 + 0.003 * x, 2e-4 * x * y - 3e-5 * y**2 + 0.001 * y])

    reading = ddic.measure_probe(make_result(quadratic), ddic.StrainGauge("g", (80.0, 60.0), 45))
    np.testing.assert_allclose(reading.strain[0], [0.003, 0.001, 0.0], atol=1e-13)


def test_strain_tensors_of_a_gauge_and_a_point(make_result: MakeResult) -> None:
    stretched = turn(0.3, 0.02)
    result = make_result(lambda points: points @ (stretched - np.eye(2)).T)
    for probe in (ddic.StrainGauge("g", (60.0, 60.0), 30), ddic.PointProbe("p", (63.0, 57.0))):
        green = ddic.measure_probe(result, probe, "green-lagrange")
        hencky = ddic.measure_probe(result, probe, "hencky")
        # E and ln U of a stretch of 1.02 along x before the turn; rounding of nodes' gradients.
        np.testing.assert_allclose(green.strain[0], [0.5 * (1.02**2 - 1.0), 0.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(hencky.strain[0], [np.log(1.02), 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.5, np.pi / 2, np.pi])
def test_elongation_knows_no_rotation(make_result: MakeResult, angle: float) -> None:
    result = make_result(lambda points: points @ (turn(angle, 0.013) - np.eye(2)).T)
    along_x = [ddic.Extensometer("e", (20.0, 33.0), (177.0, 33.0)), ddic.StrainGauge("g", (60.0, 60.0), 30),
               ddic.LineProbe("l", (20.0, 40.0), (110.0, 40.0), spacing=7.0)]
    for probe in along_x:
        assert ddic.measure_probe(result, probe).along == pytest.approx(0.013, abs=1e-12)


def test_extensometer_across_a_hole(make_result: MakeResult) -> None:
    """Only its ends count; (L - L0) / L0 of the linear field along a slanted base."""
    start, end = np.array([110.0, 110.0]), np.array([190.0, 195.0])
    reading = ddic.measure_probe(make_result(linear), ddic.Extensometer("e", (110.0, 110.0), (190.0, 195.0)))
    moved = end + linear(end[None])[0] - start - linear(start[None])[0]
    rest = np.linalg.norm(end - start)
    assert reading.along[0] == pytest.approx((np.linalg.norm(moved) - rest) / rest, abs=1e-13)
    assert reading.note == ""


def test_line_has_both_ends_and_gaps(make_result: MakeResult) -> None:
    reading = ddic.measure_probe(make_result(linear), ddic.LineProbe("l", (110.0, 150.0), (190.0, 150.0), spacing=3.0))
    # 80 px in 27 equal steps of at most 3 px.
    assert len(reading.distance) == 28
    np.testing.assert_array_equal(reading.points[[0, -1]], [[110.0, 150.0], [190.0, 150.0]])
    missing = np.isnan(reading.displacement).any(axis=1)
    np.testing.assert_array_equal(missing, np.abs(reading.points[:, 0] - 150.0) < 19.9)
    assert reading.note == f"{missing.sum()} of 28 places outside the mesh or in a hole"
    np.testing.assert_allclose(reading.displacement[~missing], linear(reading.points[~missing]), atol=1e-12)
    np.testing.assert_allclose(reading.strain[~missing], [[0.004, -0.003, -0.0005]] * int((~missing).sum()), atol=1e-12)


def test_probes_that_leave_the_mesh_read_nothing_and_say_why(make_result: MakeResult) -> None:
    result = make_result(linear)
    for probe in (ddic.PointProbe("p", (-5.0, 20.0)), ddic.StrainGauge("g", (150.0, 125.0), 30),
                  ddic.Extensometer("e", (20.0, 20.0), (300.0, 20.0))):
        reading = ddic.measure_probe(result, probe)
        assert np.isnan(reading.along).all()
        assert np.isnan(reading.displacement).all()
        assert "outside the mesh or in a hole" in reading.note


def test_what_was_not_measured_or_is_doubtful_is_said(make_result: MakeResult) -> None:
    result = make_result(linear, doubtful=True)
    result.displacement[result.mesh.nodes[:, 0] < 15] = np.nan
    reading = ddic.measure_probe(result, ddic.PointProbe("p", (12.0, 20.0)))
    assert reading.note == "1 of 1 places where nothing was measured; 1 of 1 places in doubtful cells"
    before = replace(result, point_data={})
    assert "no strain at nodes" in ddic.measure_probe(before, ddic.PointProbe("p", (80.0, 80.0))).note


def test_gauge_over_a_discontinuity_is_marked(make_result: MakeResult) -> None:
    case = json.dumps({"discontinuity": [{"vertices": [[-10.0, 70.0], [210.0, 70.0]]}]})
    result = make_result(linear, case={"json": case})
    assert "discontinuity" in ddic.measure_probe(result, ddic.StrainGauge("g", (80.0, 60.0), 30)).note
    assert ddic.measure_probe(result, ddic.StrainGauge("g", (80.0, 40.0), 30)).note == ""


@pytest.mark.parametrize(("make", "text"), [
    (lambda: ddic.StrainGauge("g", (1, 1), 0), "g: length = 0; a positive number"),
    (lambda: ddic.LineProbe("l", (1, 1), (1, 1)), "l: both ends are \\(1, 1\\)"),
    (lambda: ddic.LineProbe("l", (0, 0), (9, 0), spacing=1e-6), "places along the line"),
    (lambda: ddic.PointProbe("p", (1, float("nan"))), "p: 1, nan: finite numbers expected"),
])
def test_impossible_probes_are_refused(make, text: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=text):
        make()

"""Standard deviations of openings: those of repeated measurements, whatever the partition, and where they are shown."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from mpi4py import MPI
from numpy.typing import NDArray

import ddic
from bench.support.opened_pair import Opened, render
from ddic.cli.plot import plot
from ddic.cli.tables import opening

SIZE = 200
MESH = ddic.structured_mesh((20, 20, 180, 180), 20)
LINE = np.array([[-50.0, 40.0], [250.0, 160.0]])
SLID = Opened((LINE,), (np.array([0.4, 0.1]),))
REGULARIZED = {"regularization": {"cut_off_wavelength": 60}}
KNOWN: dict[str, Any] = {"output": {"uncertainty": True}}


def _draw(seed: int) -> tuple[NDArray[Any], NDArray[Any]]:
    return render(SLID, SIZE, noise=2.0, seed=seed, speckle=1.0)


def _measure(seed: int, direction: str = "both", **options: Any) -> ddic.Opening:
    return ddic.measure_opening(ddic.measure(_draw(seed), MESH, discontinuity=SLID.sections(direction), **options))


@pytest.mark.parametrize("regularization", [{}, REGULARIZED], ids=["free", "regularized"])
def test_they_are_those_of_repeated_measurements(regularization: dict[str, Any]) -> None:
    told = _measure(0, **regularization, **KNOWN)
    repeated = [_measure(seed, **regularization) for seed in range(24)]
    for name in ("tangential", "normal"):
        scatter = np.std([getattr(one, name) for one in repeated], axis=0, ddof=1)
        sigma = getattr(told, f"sigma_{name}")
        # 23 degrees of freedom at each of about nine places that know little of each other: 5 %.
        assert np.sqrt((sigma**2).mean() / (scatter**2).mean()) == pytest.approx(1.0, abs=0.15)
        # At a place by itself 15 %, and what the noise of grad f does there.
        assert np.median(sigma / scatter) == pytest.approx(1.0, abs=0.25)
        assert (getattr(told, f"bias_{name}") is None) == (not regularization)


def test_what_may_not_open_has_none() -> None:
    told = _measure(0, "tangential", **KNOWN)
    assert told.sigma_tangential is not None
    assert told.sigma_normal is not None
    assert told.sigma_tangential.min() > 0.005
    # Strain between the sides, which are looked up 0.04 px apart.
    assert told.sigma_normal.max() < 2e-4


@pytest.mark.parallel([1, 3])
def test_they_are_the_same_on_any_number_of_subdomains() -> None:
    split = _measure(0, **REGULARIZED, **KNOWN, solver={"method": "dual", "subdomains": 4})
    whole = _measure(0, **REGULARIZED, **KNOWN, solver={"method": "monolithic"}, comm=MPI.COMM_SELF)
    np.testing.assert_array_equal(split.distance, whole.distance)
    for name in ("sigma_tangential", "sigma_normal"):
        # What the linear steps may leave, and the noise, which is told of a residual that is not the same to the last
        # digit. Parts of cut cells whose forces go with those of a cell beside them make 30 % at a place.
        ratio = getattr(split, name) / getattr(whole, name)
        np.testing.assert_allclose(ratio, 1.0, atol=0.06)


def test_a_line_that_has_no_place_has_none() -> None:
    """A line that cuts one element, in which it bends."""
    short = Opened((np.array([[78.0, 130.0], [90.0, 138.0], [102.0, 130.0]]),), (np.zeros(2),))
    lines = [*SLID.sections("both"), *short.sections("both")]
    result = ddic.measure(_draw(0), MESH, discontinuity=lines, **KNOWN)
    first, second = (ddic.measure_opening(result, number) for number in (1, 2))
    assert first.sigma_normal is not None
    assert np.isfinite(first.sigma_normal).all()
    assert second.sigma_normal is not None
    assert len(second.distance) == len(second.sigma_normal) == 0


def test_tables_and_pictures_show_them(tmp_path: Path) -> None:
    headers = {}
    for name, more in (("plain", {}), ("known", {"uncertainty": True}), ("both", {"uncertainty": True})):
        path = tmp_path / f"{name}.vtkhdf"
        options = REGULARIZED if name == "both" else {}
        ddic.measure(_draw(0), MESH, discontinuity=SLID.sections("both"), output={"file": str(path), **more}, **options)
        found = CliRunner().invoke(opening, [str(path)])
        assert found.exit_code == 0, found.output
        rows = np.genfromtxt(tmp_path / f"{name}.opening.csv", delimiter=",", names=True)
        headers[name] = rows.dtype.names[8:]
        assert CliRunner().invoke(plot, [str(path), "--kind", "opening"]).exit_code == 0
        for column in headers[name]:
            assert np.isfinite(rows[column]).all()
    assert headers == {"plain": (), "known": ("sigma_tangential_px", "sigma_normal_px"),
                       "both": ("sigma_tangential_px", "sigma_normal_px", "bias_tangential_px", "bias_normal_px")}
    read = ddic.measure_opening(ddic.open(tmp_path / "known.vtkhdf"))
    assert read.sigma_normal is not None
    # The first table has six digits.
    np.testing.assert_allclose(read.sigma_normal, np.genfromtxt(tmp_path / "known.opening.csv", delimiter=",",
                                                                names=True)["sigma_normal_px"], rtol=1e-4)

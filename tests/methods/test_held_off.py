"""A cut-off wavelength that is long beside what the specimen does: it converges, and what is held off is marked."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.special import erf

import ddic
from ddic.methods.run import run_file
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.results.summary import SeriesSummary
from ddic.visibility.exclusions import HELD_OFF, KEPT
from support.oracles import make_on_root
from support.spoilt import digitise

Array = NDArray[np.float64]
WIDTH, HEIGHT, NECK = 160, 480, 40.0
MESH = ddic.structured_mesh((32, 48, 128, 432), 12)
TIGHT = {"tolerance": 1e-13, "rms_tolerance": 1e-9, "max_iterations": 400}


def move(points: Array) -> Array:
    """A strain of 1 % along y with a Gaussian neck of 20 %."""
    y = points[..., 1] - HEIGHT / 2
    bulge = 0.2 * NECK * np.sqrt(np.pi / 2) * erf(y / (np.sqrt(2) * NECK))
    strain = 0.01 + 0.2 * np.exp(-(y**2) / (2 * NECK**2))
    return np.asarray(np.stack([-0.4 * strain * (points[..., 0] - WIDTH / 2), 0.01 * y + bulge], axis=-1))


@cache
def render() -> tuple[Array, Array]:
    """Speckle that the neck carries along, with noise of 2 grey levels."""
    columns, rows = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    pixels = np.stack([columns, rows], axis=-1).astype(float)
    source = pixels.copy()
    for _ in range(60):
        source = pixels - move(source)
    generator = np.random.default_rng(7)
    waves = generator.normal(0.0, 0.45, (400, 2))
    phases = generator.uniform(0.0, 2 * np.pi, 400)

    def draw(points: Array) -> Array:
        grey = np.zeros(points.shape[:2])
        for wave, phase in zip(waves, phases, strict=True):
            grey += np.cos(points @ wave + phase)
        return np.asarray(128.0 + 3.0 * grey + generator.normal(0.0, 2.0, grey.shape))

    return digitise(draw(pixels)), digitise(draw(source))


def measure(options: dict[str, Any], comm: MPI.Comm = MPI.COMM_SELF) -> ddic.Result:
    settings = {"regularization": {"cut_off_wavelength": 300.0}} | options
    return ddic.measure(render(), MESH, comm=comm, **settings)


def measure_off(result: ddic.Result) -> Array:
    """How far nodes are off, pixels."""
    return np.asarray(np.linalg.norm(result.displacement - move(MESH.nodes), axis=1))


def test_a_long_wavelength_converges_and_marks_what_it_holds_off() -> None:
    result = measure({})
    states = result.fields["excluded"]
    off = measure_off(result)
    of_cells = off[MESH.connectivity.reshape(-1, 4)].mean(axis=1)
    assert set(np.unique(states)) <= {KEPT, HELD_OFF}
    # What stands out is off by 0.6 px or more; a cell beside that shows as little of a speckle may be too, and pulls.
    assert (states == HELD_OFF).sum() >= 5
    assert of_cells[states == HELD_OFF].min() > 0.6
    # Cells at the neck pull, and all others are within l_c of one.
    assert result.fields["doubtful"].all()
    # Of the 10 px by which the neck moves its ends, mechanics hold off 6 where they are 8 px off without a pull, whose
    # force ends with what grey levels capture.
    alone = measure({"correlation": {"spoilt_pixels": "keep"}})
    assert off.max() <= 0.8 * measure_off(alone).max()
    assert np.sqrt((off**2).mean()) <= np.sqrt((measure_off(alone)**2).mean())
    assert (alone.fields["excluded"] == KEPT).all()
    assert not alone.fields["doubtful"].all()


@pytest.mark.parametrize(("cut_off_wavelength", "least_off"), [(60.0, 1.0), (90.0, 2.5)])
def test_a_clean_pair_that_is_held_off_and_not_pulled_pays_nothing(cut_off_wavelength: float,
                                                                   least_off: float) -> None:
    regularization = {"regularization": {"cut_off_wavelength": cut_off_wavelength}}
    looked, kept = (measure(regularization | {"correlation": {"spoilt_pixels": what}}) for what in ("exclude", "keep"))
    # Guards the test: nodes are off by more than the residual of other speckle bears.
    assert measure_off(looked).max() > least_off
    assert (looked.fields["excluded"] == KEPT).all()
    # Every pixel counts in every pass, and the field has the same bits.
    np.testing.assert_array_equal(looked.gauss_newton["n_pixels"], kept.gauss_newton["n_pixels"])
    np.testing.assert_array_equal(looked.displacement, kept.displacement)
    np.testing.assert_array_equal(looked.gauss_newton["rms_correction_px"], kept.gauss_newton["rms_correction_px"])


@pytest.mark.parallel([3])
@pytest.mark.parametrize("solver", [{"method": "dual", "partition": "blocks", "blocks": [2, 4], "tolerance": 1e-12},
                                    {"method": "assembled"}], ids=["dual", "assembled"])
def test_any_number_of_ranks_holds_off_the_same(solver: dict[str, Any]) -> None:
    options = {"gauss_newton": TIGHT, "solver": solver}
    together = measure(options, MPI.COMM_WORLD)

    def measure_alone() -> tuple[Array, Array]:
        alone = measure(options)
        return alone.displacement, alone.fields["excluded"]

    displacement, states = make_on_root(measure_alone)
    np.testing.assert_array_equal(together.fields["excluded"], states)
    assert (states == HELD_OFF).any()
    # Where cells are seen is found from a rough field, which differs by 0.01 px with the start of other subdomains.
    np.testing.assert_allclose(together.displacement, displacement, atol=2e-2)


def test_the_frame_after_one_that_is_held_off_is_searched_for(tmp_path: Path) -> None:
    reference, deformed = render()
    for name, image in (("f.tif", reference), ("g_1.tif", deformed), ("g_2.tif", deformed)):
        tifffile.imwrite(tmp_path / name, image)
    case = tmp_path / "case.toml"
    case.write_text("""[images]
reference = "f.tif"
deformed = "g_*.tif"
[mesh.structured]
region = [32, 48, 128, 432]
element_size = 12
[regularization]
cut_off_wavelength = 300
""", encoding="utf-8")
    summary = run_file(Team.alone(), case, Silence())
    assert isinstance(summary, SeriesSummary)
    assert [frame.started_from for frame in summary.frames] == ["a search", "a search"]
    one, two = ddic.open_series(tmp_path / "result.vtkhdf")
    np.testing.assert_array_equal(one.displacement, two.displacement)
    np.testing.assert_array_equal(one.fields["excluded"], two.fields["excluded"])
    assert (one.fields["excluded"] == HELD_OFF).any()

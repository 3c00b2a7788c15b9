"""PGD-DIC from Python, its figures and what ``ddic info`` says of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import ddic
from ddic.cli.info import info
from ddic.cli.plot import plot
from ddic.errors import InputError
from ddic.kinematics.nodal import NodalRegion
from support.cases import WAVES
from support.pictures import pair_of, rms_error_at

REGION = (24.0, 24.0, 168.0, 168.0)
POINTS = np.random.default_rng(0).uniform(24, 168, (500, 2))


def _pair() -> tuple[Any, Any]:
    pair = pair_of(WAVES)
    return pair.reference, pair.deformed


def _structured(size: float, **more: Any) -> dict[str, Any]:
    return {"pgd": {}, "mesh": {"structured": {"region": REGION, "element_size": size}}, **more}


def test_mesh_and_region_give_the_same() -> None:
    by_region = ddic.measure(_pair(), **_structured(16))
    by_mesh = ddic.measure(_pair(), ddic.structured_mesh(REGION, 16), pgd={})
    assert np.array_equal(by_region.at(POINTS), by_mesh.at(POINTS))
    assert rms_error_at(by_region, WAVES, POINTS) <= 0.01
    assert np.isnan(by_region.at(np.array([[5.0, 5.0]]))).all()


def test_elements_of_a_pixel_are_measured() -> None:
    result = ddic.measure(_pair(), **_structured(1, regularization={"cut_off_wavelength": 48}))
    assert result.separated.along_x.n_nodes == 145
    # A cut-off of 48 px on waves of 256 px and more.
    assert rms_error_at(result, WAVES, POINTS) <= 0.01


def test_session_starts_from_the_last_frame() -> None:
    reference, deformed = _pair()
    with ddic.prepare(reference, **_structured(16)) as session:
        first = session.measure(deformed)
        second = session.measure(deformed, from_last=True)
        assert (session.n_assembled, session.n_factorized) == (0, 0)
    assert len(second.corrections["gain"]) <= 1
    assert np.abs(second.at(POINTS) - first.at(POINTS)).max() <= 0.01


@pytest.mark.parametrize(("mesh", "options", "words"), [
    (None, {"pgd": {}}, "mesh: none is given"),
    ({"file": ddic.structured_mesh(REGION, 16), **_structured(16)["mesh"]}, {"pgd": {}},
     "mesh.structured stands for the mesh; leave one of them out"),
    (ddic.structured_mesh(REGION, 16, "T3"), {"pgd": {}}, "a whole rectangle of Q4 elements"),
    (ddic.structured_mesh(REGION, 16, circles=[((96.0, 96.0), 20.0)]), {"pgd": {}}, "a whole rectangle of Q4"),
    (ddic.structured_mesh((0, 0, 400, 160), 16), {"pgd": {}}, "the mesh lies outside the image"),
])
def test_meshes_that_do_not_fit_are_refused(mesh: Any, options: Any, words: str) -> None:
    with pytest.raises(InputError) as caught:
        ddic.measure(_pair(), mesh, **options)
    assert words in str(caught.value)


def test_kinematics_are_refused() -> None:
    with pytest.raises(InputError, match=r"kinematics: \[pgd\] has products of functions"):
        ddic.measure(_pair(), ddic.structured_mesh(REGION, 16), kinematics=NodalRegion, pgd={})


@pytest.mark.parametrize("flip", [False, True])
def test_written_result_is_read_back(tmp_path: Path, flip: bool) -> None:
    path = tmp_path / "r.vtkhdf"
    result = ddic.measure(_pair(), **_structured(16, output={"file": path, "flip_y": flip}))
    stored = ddic.open(path)
    assert np.array_equal(stored.at(POINTS), result.at(POINTS))
    assert np.array_equal(stored.displacement, result.displacement)
    assert stored.flipped == flip


def test_figures_and_description(tmp_path: Path) -> None:
    path = tmp_path / "r.vtkhdf"
    ddic.measure(_pair(), **_structured(16, start={"pyramid": False}), output=path)
    for kind in ("modes", "corrections", "all"):
        done = CliRunner().invoke(plot, [str(path), "--kind", kind])
        assert done.exit_code == 0, done.output
        if kind != "all":
            assert (tmp_path / f"r.{kind}.png").stat().st_size > 10_000
    text = CliRunner().invoke(info, [str(path)]).output
    assert "PGD-DIC" in text
    assert "RMS of modes" in text
    assert "Gauss-Newton" not in text


def test_figures_of_other_methods_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.vtkhdf"
    ddic.measure(_pair(), ddic.structured_mesh(REGION, 48), output=path)
    for kind in ("modes", "corrections"):
        done = CliRunner().invoke(plot, [str(path), "--kind", kind])
        assert done.exit_code == 2
        assert "was not measured by PGD-DIC" in done.output

"""Near and far images in one measurement, from images to a field and the motion of the near set-up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.case.loader import load_case
from ddic.errors import InputError, is_collective
from ddic.io.mapping_file import MappingFile, write_mapping
from ddic.methods.run import run_case
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.results.measurement import Measurement
from ddic.synth.fields import DisplacementField, Hole, Kirsch
from ddic.synth.near_far_scene import SetUpMotion
from support.cases import Ears
from support.measuring import measure, subdomain_numbers, whole_field
from support.near_far_cases import (
    ALPHA,
    FOCUS,
    HEIGHT,
    PLAIN,
    SOLVER,
    STRETCHED,
    TIGHT,
    WIDTH,
    NearField,
    case_text,
    near_section,
    write_pairs,
)

RANKS = [1, 3]
REGULARIZED = "[regularization]\ncut_off_wavelength = 40.0\n"
TIGHT_SOLVER = "[solver]\nsubdomains = 5\ntolerance = 1e-12\n"
# Gauss-Newton to 1e-10, Krylov to 1e-12: what is left between two ways of adding up is far below 1e-8 px.
SAME_PX = 1e-8


def _on_root(folder: Path, text: str, **images: object) -> Path:
    """Write images and case on rank 0; the case's path."""
    path = folder / "case.toml"
    if MPI.COMM_WORLD.rank == 0:
        write_pairs(folder, **images)
        path.write_text(text, encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    return path


def _rewritten(path: Path, text: str) -> Path:
    MPI.COMM_WORLD.barrier()
    if MPI.COMM_WORLD.rank == 0:
        path.write_text(text, encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    return path


def _measure(path: Path, team: Team | None = None, ears: Ears | None = None) -> Measurement:
    return measure(team or Team(MPI.COMM_WORLD), path, ears)


def _alone(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Field and motion that rank 0 finds by itself, on all ranks."""
    found = None
    if MPI.COMM_WORLD.rank == 0:
        measured = _measure(path, Team.alone())
        found = whole_field(measured), _motion(measured)
    return MPI.COMM_WORLD.bcast(found)


def _motion(measurement: Measurement) -> NDArray[np.float64]:
    """Alpha in px and theta in px at the field's end, of each near camera, one after the other."""
    return np.concatenate([[*m.alpha, m.theta * m.setup.length] for m in measurement.motions])


def _rms_error(measurement: Measurement, field: DisplacementField, camera: int | None = None) -> float:
    """RMS over nodes (their copies) of all ranks, or of one camera's, far px."""
    pieces = Team(MPI.COMM_WORLD).gather_lists([
        (u.reshape(-1, 2) - field.displacement(s.mesh.nodes)).ravel()
        for s, u in zip(measurement.subdomains, measurement.displacements, strict=True)
        if camera is None or s.camera == camera])
    return float(np.sqrt(np.mean(np.concatenate(pieces) ** 2)))


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("regularization", ["", REGULARIZED], ids=["plain", "regularized"])
def test_a_stretched_plate(shared_path: Path, regularization: str) -> None:
    measured = _measure(_on_root(shared_path, case_text(near_section(), more=TIGHT_SOLVER + TIGHT + regularization)))
    (motion,) = measured.motions
    assert {s.camera for s in measured.subdomains} <= {0, 1}
    # The mesh holds this field, grey levels are not rounded: what is left is interpolation between grey levels, some
    # 1e-3 px at spots of 5 px; alpha hangs on the nodes of the near field's edge, less exact than those inside.
    assert np.abs(motion.alpha - ALPHA).max() <= 3e-3
    assert motion.theta == 0.0
    assert _rms_error(measured, STRETCHED) <= 4e-3
    assert measured.largest_jump <= 1e-10
    np.testing.assert_allclose(motion.setup.centre, FOCUS, atol=1e-12)


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.02, -0.03)], ids=["upright", "tilted"])
def test_a_set_up_that_turns(shared_path: Path, tilt: tuple[float, float]) -> None:
    near = NearField(motion=SetUpMotion(ALPHA, 0.8, FOCUS), tilt=tilt)
    path = _on_root(shared_path, case_text(near_section(near, 'mapping_file = "mapping.toml"\nmotion = "rigid"')),
                    near=near)
    if MPI.COMM_WORLD.rank == 0:
        write_mapping(shared_path / "mapping.toml", MappingFile(near.mapping, (WIDTH, HEIGHT), (WIDTH, HEIGHT)))
    measured = _measure(_rewritten(path, path.read_text()))
    (motion,) = measured.motions
    # X0 is the point in the picture's middle, tilted or not.
    np.testing.assert_allclose(motion.setup.centre, FOCUS, atol=1e-9)
    assert np.abs(motion.alpha - ALPHA).max() <= 4e-3
    # As much at the near field's corners, 39 px from its centre.
    assert abs(motion.theta - np.deg2rad(0.8)) * motion.setup.length <= 4e-3
    assert _rms_error(measured, STRETCHED) <= 4e-3


@pytest.mark.parallel([1, 3])
def test_a_turn_that_is_not_asked_for_spoils_the_field(shared_path: Path) -> None:
    # Guards the test above.
    near = NearField(motion=SetUpMotion(ALPHA, 0.8, FOCUS))
    measured = _measure(_on_root(shared_path, case_text(near_section(near)), near=near))
    assert _rms_error(measured, STRETCHED) > 3e-2


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("regularization", ["", REGULARIZED], ids=["plain", "regularized"])
@pytest.mark.parametrize("more", ['motion = "translation"\nnoise = 0.5',
                                  'motion = "rigid"\nnoise = 0.5\nuse_far = true'],
                         ids=["translation", "rigid, far as well"])
def test_field_depends_neither_on_ranks_nor_on_the_solver(shared_path: Path, more: str, regularization: str) -> None:
    def text(solver: str) -> str:
        return case_text(near_section(more=more), images="noise = 0.5", more=solver + TIGHT + regularization)

    path = _on_root(shared_path, text(TIGHT_SOLVER))
    team = Team(MPI.COMM_WORLD)
    measured = _measure(path, team)
    field, motion = whole_field(measured), _motion(measured)
    one_rank = _alone(path)
    assert subdomain_numbers(measured) == list(range(5))
    other = _measure(_rewritten(path, text(TIGHT_SOLVER + 'method = "assembled"\n')), team)
    for u, alpha in (one_rank, (whole_field(other), _motion(other))):
        assert np.abs(field - u).max() <= SAME_PX
        assert np.abs(motion - alpha).max() <= SAME_PX
    # 2 sigma^2 A^-1 M A^-1 to the linear solvers' tolerance.
    np.testing.assert_allclose(measured.motions[0].covariance, other.motions[0].covariance, rtol=1e-6,
                               atol=1e-6 * measured.motions[0].covariance[0, 0])


@pytest.mark.parallel([1, 3])
def test_a_plate_with_a_hole(shared_path: Path) -> None:
    hole = (119.5, 99.5)
    field = Kirsch(hole, 24.0, 0.005)
    mesh = "region = [20, 20, 220, 180]\ncircles = [{center = [119.5, 99.5], radius = 27}]"
    path = _on_root(shared_path, case_text(near_section(), region=mesh, element=8.0), field=field,
                    hole=Hole(hole, 24.0))
    measured = _measure(path)
    # Bilinear cells of 8 px leave h^2/8 u'' = 8 x 3 strain / radius = 5e-3 px at the hole's edge, less elsewhere.
    assert np.abs(measured.motions[0].alpha - ALPHA).max() <= 3e-3
    assert _rms_error(measured, field) <= 5e-3


@pytest.mark.parallel([1, 3])
def test_noise_is_estimated_or_given(shared_path: Path) -> None:
    sigma = (3.0, 1.5)
    path = _on_root(shared_path, case_text(near_section()), noise=sigma)
    ears = Ears()
    measured = _measure(path, ears=ears)
    # Of some 30 000 pixels; a few per cent are taken by what nodes follow of the noise, and by interpolation, which
    # smooths half of it.
    np.testing.assert_allclose(measured.noise, sigma, rtol=0.15)
    assert [note for note in ears.notes if "estimated from the residual" in note] == [
        f"far field: noise of {measured.noise[0]:.2f} grey levels (estimated from the residual)",
        f"near field 1: noise of {measured.noise[1]:.2f} grey levels (estimated from the residual)"]
    (motion,) = measured.motions
    deviation = np.sqrt(np.diag(motion.covariance))
    # Normal to five standard deviations, and not far more cautious than that.
    assert np.abs((motion.alpha - ALPHA) / deviation).max() <= 5
    assert (deviation < 0.05).all()
    text = case_text(near_section(more=f"noise = {sigma[1]}"), images=f"noise = {sigma[0]}")
    given = _measure(_rewritten(path, text), ears=ears)
    assert given.noise == sigma
    assert "near field 1: noise of 1.50 grey levels (given)" in ears.notes
    # Squared grey levels are counted in units of each camera's noise, the far field's for both.
    weights = {(v.camera, v.weight) for v in given.model.views.flat}
    assert weights <= {(0, 1.0), (1, (sigma[0] / sigma[1]) ** 2)}


@pytest.mark.parallel([1, 3])
def test_the_unit_of_grey_levels_changes_nothing(shared_path: Path) -> None:
    # The far image in [0, 1], the near one as it is: a least noise in grey levels would drown what the far one sees.
    path = _on_root(shared_path, case_text(near_section(), more=TIGHT_SOLVER + TIGHT), noise=(3.0, 1.5))
    expected = _measure(path)
    if MPI.COMM_WORLD.rank == 0:
        for name in ("far_reference", "far_deformed"):
            image = tifffile.imread(shared_path / f"{name}.tif")
            tifffile.imwrite(shared_path / f"{name}.tif", (image / 255.0).astype(np.float32))
    MPI.COMM_WORLD.barrier()
    found = _measure(path)
    np.testing.assert_allclose(found.noise, (expected.noise[0] / 255, expected.noise[1]), rtol=1e-5)
    # Grey levels in [0, 1] are rounded to float32 elsewhere.
    assert np.abs(whole_field(found) - whole_field(expected)).max() < 1e-5
    assert np.abs(_motion(found) - _motion(expected)).max() < 1e-5


@pytest.mark.parallel([1])
def test_covariance_is_that_of_repeated_measurements(shared_path: Path) -> None:
    found, expected = [], []
    path = _on_root(shared_path, case_text(near_section(more="noise = 2.0"), images="noise = 2.0"))
    clean = {name: tifffile.imread(shared_path / f"{name}.tif") for name in
             ("far_reference", "far_deformed", "near_reference", "near_deformed")}
    rng = np.random.default_rng(0)
    for _ in range(24):
        for name, image in clean.items():
            tifffile.imwrite(shared_path / f"{name}.tif",
                             (image + rng.normal(0.0, 2.0, image.shape)).astype(np.float32))
        (motion,) = _measure(path).motions
        found.append(motion.alpha)
        expected.append(np.diag(motion.covariance))
    ratio = np.var(found, axis=0, ddof=1) / np.mean(expected, axis=0)
    # Divided by its degrees of freedom, 23, chi^2 lies between 0.31 and 2.2 in 99.9 % of cases; interpolation smooths
    # the deformed image's noise.
    assert (ratio >= 0.25).all()
    assert (ratio <= 2.3).all()


@pytest.mark.parallel([1, 3])
def test_two_near_fields(shared_path: Path) -> None:
    second = NearField((70.0, 90.0), SetUpMotion((-1.3, 2.4), 0.0, (70.0, 90.0)))
    if MPI.COMM_WORLD.rank == 0:
        write_pairs(shared_path / "second", second)
    path = _on_root(shared_path, case_text(near_section(), near_section(second, folder="second/")))
    measured = _measure(path)
    assert [m.camera for m in measured.motions] == [1, 2]
    np.testing.assert_allclose([m.alpha for m in measured.motions], [ALPHA, (-1.3, 2.4)], atol=4e-3)
    assert _rms_error(measured, STRETCHED) <= 4e-3


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize(("motion", "degrees", "first_rms"), [("translation", 0.0, 1e-6), ("rigid", 0.8, 5e-3)])
def test_start_from_an_earlier_result(shared_path: Path, motion: str, degrees: float, first_rms: float) -> None:
    near = NearField(motion=SetUpMotion(ALPHA, degrees, FOCUS))
    solver = TIGHT_SOLVER + TIGHT
    section, images = near_section(near, f'motion = "{motion}"\nnoise = 0.5'), "noise = 0.5"
    path = _on_root(shared_path, case_text(section, images=images, more=solver), near=near)
    team = Team(MPI.COMM_WORLD)
    first = _measure(path, team)
    run_case(team, path, Silence())
    # Without the independent start nothing but the earlier result can bring it near the solution.
    start = '[start]\nfrom_result = "result.vtkhdf"\nindependent = false\n'
    again = _measure(_rewritten(path, case_text(section, images=images, more=solver + start)), team)
    # From its own solution on; a rotation is found anew from its tangent, theta^2 / 2 of 39 px off.
    assert again.records[0].size.rms <= first_rms
    assert np.abs(whole_field(again) - whole_field(first)).max() <= SAME_PX
    np.testing.assert_allclose(_motion(again), _motion(first), atol=SAME_PX)


@pytest.mark.parallel([1, 3])
def test_a_result_without_near_images_is_no_start(shared_path: Path) -> None:
    path = _on_root(shared_path, case_text())
    run_case(Team(MPI.COMM_WORLD), path, Silence())
    _rewritten(path, case_text(near_section(), more=SOLVER + '[start]\nfrom_result = "result.vtkhdf"\n'))
    with pytest.raises(InputError, match="holds no motion of near field 1") as caught:
        _measure(path)
    assert is_collective(caught.value)


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize(("near", "keys", "message"), [
    (near_section(more="region = [150, 100, 155, 105]"), {}, "near, entry 1.*see no whole element.*near.region"),
    (near_section(more="margin = 95.0"), {}, "see no whole element.*near.margin"),
    (near_section(), {"region": "region = [140, 90, 160, 110]"}, "see every element"),
    (near_section(NearField((-300.0, 100.0))), {}, "see no whole element"),
], ids=["region", "margin", "whole mesh", "outside"])
def test_what_leaves_a_camera_nothing_is_refused(shared_path: Path, near: str, keys: dict[str, str],
                                                 message: str) -> None:
    path = _on_root(shared_path, case_text(near, **keys))
    with pytest.raises(InputError, match=message) as caught:
        _measure(path)
    assert is_collective(caught.value)


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize(("near", "message"), [
    (near_section(NearField((-300.0, 100.0))), "near, entry 1.*lies outside the far-field image"),
    (near_section().replace("ratio = 4.0", "ratio = 8.0"), "near, entry 1"),
    (near_section(NearField((100.0, 80.0))), "does not show what the far-field image"),
], ids=["outside", "ratio", "elsewhere"])
def test_a_run_checks_where_the_near_images_lie(shared_path: Path, near: str, message: str) -> None:
    path = _on_root(shared_path, case_text(near))
    with pytest.raises(InputError, match=message) as caught:
        run_case(Team(MPI.COMM_WORLD), path, Silence())
    assert is_collective(caught.value)
    assert not (shared_path / "result.vtkhdf").exists()


@pytest.mark.parallel([3])
def test_more_ranks_than_subdomains_are_refused(shared_path: Path) -> None:
    path = _on_root(shared_path, case_text(near_section(), more="[solver]\nsubdomains = 2\n"))
    with pytest.raises(InputError, match=r"2 subdomains for \d MPI ranks") as caught:
        run_case(Team(MPI.COMM_WORLD), path, Silence())
    assert is_collective(caught.value)


@pytest.mark.parallel(RANKS)
def test_without_a_number_each_camera_and_each_rank_gets_a_subdomain(shared_path: Path) -> None:
    measured = _measure(_on_root(shared_path, case_text(near_section(PLAIN), more="")))
    team = Team(MPI.COMM_WORLD)
    cameras = team.gather_lists([s.camera for s in measured.subdomains])
    assert len(cameras) == max(2, team.size)
    assert set(cameras) == {0, 1}


def test_every_camera_needs_a_subdomain(tmp_path: Path) -> None:
    path = tmp_path / "case.toml"
    path.write_text(case_text(near_section(), more="[solver]\nsubdomains = 1\n"), encoding="utf-8")
    with pytest.raises(InputError, match=r"solver.subdomains = 1: .* a subdomain each; ask for at least 2"):
        load_case(path)


def test_the_monolithic_method_knows_one_camera(tmp_path: Path) -> None:
    path = tmp_path / "case.toml"
    path.write_text(case_text(near_section(), more='[solver]\nmethod = "monolithic"\n'), encoding="utf-8")
    with pytest.raises(InputError, match=r'monolithic.*near.*"assembled"'):
        load_case(path)

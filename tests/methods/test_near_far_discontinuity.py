"""A line that crosses near and far elements: the slip along it, by all solvers, whatever the ranks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.case.loader import load_case
from ddic.errors import InputError
from ddic.io.mapping_file import MappingFile, write_mapping
from ddic.parallel.team import Team
from ddic.results.publishing import gather
from support.measuring import measure
from support.near_far_cases import (
    ALPHA,
    HEIGHT,
    PLAIN,
    TIGHT,
    WIDTH,
    NearField,
    case_text,
    near_section,
    write_pairs,
)

Array = NDArray[np.float64]
RANKS = [1, 3]
MIDDLE = np.array([148.3, 97.9])
ANGLE = np.deg2rad(21.0)
TANGENT, NORMAL = np.array([np.cos(ANGLE), np.sin(ANGLE)]), np.array([-np.sin(ANGLE), np.cos(ANGLE)])
LINE = [(MIDDLE - 300 * TANGENT).tolist(), (MIDDLE + 300 * TANGENT).tolist()]
SLIP = 0.8
DISCONTINUITY = f'[[discontinuity]]\nvertices = {LINE}\nopening = "tangential"\n'
TILTED = NearField(tilt=(0.02, -0.03))
FAR_AS_WELL = "noise = 0.5\nuse_far = true"
REGULARIZED = "[regularization]\ncut_off_wavelength = 40.0\n"


@dataclass(frozen=True)
class Sliding:
    """Both sides move along the line, so that no point changes sides."""

    def displacement(self, points: Array) -> Array:
        height = (points - MIDDLE) @ NORMAL
        along = 0.3 + np.where(height > 0, SLIP / 2, -SLIP / 2) + 1e-3 * height
        return np.asarray(along[:, None] * TANGENT)

    def gradient(self, points: Array) -> Array:
        return np.tile(1e-3 * np.outer(TANGENT, NORMAL), (len(points), 1, 1))


SLIDING = Sliding()


def _write(folder: Path, near: NearField, more: str, in_near: str = "noise = 0.5") -> Path:
    """Images and case, on rank 0; the case's path."""
    path = folder / "case.toml"
    if MPI.COMM_WORLD.rank == 0:
        write_pairs(folder, near, SLIDING)
        write_mapping(folder / "mapping.toml", MappingFile(near.mapping, (WIDTH, HEIGHT), (WIDTH, HEIGHT)))
        section = near_section(near, f'mapping_file = "mapping.toml"\n{in_near}')
        text = case_text(section, images="noise = 0.5", more=DISCONTINUITY + TIGHT + more)
        path.write_text(text, encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    return path


def _beside_the_line(reach: float, distance: float) -> tuple[Array, Array]:
    """Points on both sides of the line up to so far from its middle, at that distance from it."""
    on_line = MIDDLE + np.linspace(-reach, reach, 60)[:, None] * TANGENT
    return on_line + distance * NORMAL, on_line - distance * NORMAL


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("near", [PLAIN, TILTED], ids=["upright", "tilted"])
def test_the_slip_is_found_in_near_and_far_elements(shared_path: Path, near: NearField) -> None:
    measured = measure(Team(MPI.COMM_WORLD), _write(shared_path, near, "[solver]\nsubdomains = 5\ntolerance = 1e-12\n"))
    assert {s.camera for s in measured.subdomains} <= {0, 1}
    points = np.random.default_rng(0).uniform((30, 30), (210, 170), (2000, 2))
    is_near = (np.abs(points - (150, 100)) < (20, 15)).all(axis=1)
    result = gather(measured)
    error = result.at(points) - SLIDING.displacement(points)
    (motion,) = measured.motions
    # Grey levels are not rounded and the elements hold the field: what is left is interpolation between grey levels,
    # a quarter of it in the near image.
    assert _rms(error[is_near]) < 4e-3
    assert _rms(error) < 8e-3
    assert np.abs(motion.alpha - ALPHA).max() <= 8e-3
    above, below = _beside_the_line(15.0, 1.0)
    assert _rms(result.at(above) - result.at(below) - (SLIP + 2e-3) * TANGENT) < 2e-3
    above, below = _beside_the_line(70.0, 3.0)
    assert _rms(result.at(above) - result.at(below) - (SLIP + 6e-3) * TANGENT) < 1e-2


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("more", ["", REGULARIZED], ids=["plain", "regularized"])
def test_all_solvers_find_one_field(shared_path: Path, more: str) -> None:
    points = np.vstack(_beside_the_line(70.0, 0.5))
    alone = _write(shared_path, TILTED, more + '[solver]\nmethod = "assembled"\nsubdomains = 2\n', FAR_AS_WELL)
    expected = None
    if MPI.COMM_WORLD.rank == 0:
        expected = gather(measure(Team.alone(), alone)).at(points)
    expected = MPI.COMM_WORLD.bcast(expected)
    for solver in ("subdomains = 5", "partition = \"blocks\"\nblocks = [3, 2]",
                   'method = "conjugate_gradient"\nsubdomains = 4'):
        path = _write(shared_path, TILTED, f"{more}[solver]\n{solver}\ntolerance = 1e-12\n", FAR_AS_WELL)
        found = gather(measure(Team(MPI.COMM_WORLD), path)).at(points)
        # Krylov to 1e-12, Gauss-Newton to 1e-10.
        assert np.abs(found - expected).max() < 1e-8
        MPI.COMM_WORLD.barrier()


def test_near_meshes_of_their_own_are_refused(tmp_path: Path) -> None:
    near_mesh = "[near.mesh.structured]\nregion = [130, 80, 170, 120]\nelement_size = 4\n"
    (tmp_path / "case.toml").write_text(case_text(near_section() + near_mesh, more=DISCONTINUITY), encoding="utf-8")
    with pytest.raises(InputError, match=r"discontinuity.*leave near\.mesh out"):
        load_case(tmp_path / "case.toml")

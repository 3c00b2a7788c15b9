"""Fields that subdomains measured by themselves, kept and drawn."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import ddic
from ddic.cli.plot import plot
from ddic.errors import InputError
from ddic.io.result_reader import read_independent_fields
from ddic.parallel.team import Team

SIDE = 192
MESH = ddic.structured_mesh((16, 16, 176, 176), 16)
OPTIONS = {"solver": {"method": "dual", "subdomains": 4}, "regularization": {"cut_off_wavelength": 64}}


def field(points: np.ndarray) -> np.ndarray:
    return np.column_stack([0.4 + 0.3 * np.sin(points[:, 0] / 40), -0.2 + 0.2 * np.cos(points[:, 1] / 50)])


PAIR = ddic.make_synthetic_pair(field, (SIDE, SIDE), noise=2.0, seed=1)


@pytest.mark.parallel([1, 2, 3, 4])
def test_each_piece_has_what_its_subdomain_measured(tmp_path: Path) -> None:
    team = Team.world()
    path = team.broadcast(tmp_path) / "r.vtkhdf"
    result = ddic.measure(PAIR, MESH, **OPTIONS, output={"file": path, "independent_fields": True})
    apart = read_independent_fields(path)
    # Pieces share nodes, and have one copy each.
    assert apart.mesh.n_nodes > MESH.n_nodes
    places, copy_of = np.unique(apart.mesh.nodes, axis=0, return_inverse=True)
    assert len(places) == MESH.n_nodes
    spread = [np.ptp(apart.displacement[copy_of.reshape(-1) == k], axis=0).max() for k in range(len(places))]
    # Noise of 2 grey levels moves a node at an edge of its subdomain by some hundredths of a pixel.
    assert 0.005 < max(spread) < 0.3
    error = np.sqrt(((apart.displacement - field(apart.mesh.nodes)) ** 2).mean())
    coupled = np.sqrt(((result.displacement - field(result.mesh.nodes)) ** 2).mean())
    assert max(error, coupled) < 0.03


def test_each_subdomain_measures_what_it_measures_alone(tmp_path: Path) -> None:
    path = tmp_path / "r.vtkhdf"
    exact = {"gauss_newton": {"tolerance": 1e-10, "rms_tolerance": 0}}
    halves = {"method": "dual", "partition": "blocks", "blocks": [2, 1]}
    noiseless = ddic.make_synthetic_pair(field, (SIDE, SIDE), seed=1)
    ddic.measure(noiseless, MESH, solver=halves, output={"file": path, "independent_fields": True})
    apart = read_independent_fields(path)
    left = ddic.measure(noiseless, ddic.structured_mesh((16, 16, 96, 176), 16), **exact,
                        solver={"method": "monolithic"})
    is_left = apart.subdomain_ids == apart.subdomain_ids[np.argmin(apart.mesh.centroids[:, 0])]
    nodes = np.unique(apart.mesh.cells[is_left])
    difference = apart.displacement[nodes] - left.at(apart.mesh.nodes[nodes])
    # Independent fields stop at 0.01 px of correction (DESIGN: looser than any measurement).
    assert np.sqrt((difference**2).mean()) < 0.01


def test_plots_of_fields_apart_and_of_a_difference(tmp_path: Path) -> None:
    one, other = tmp_path / "one.vtkhdf", tmp_path / "other.vtkhdf"
    ddic.measure(PAIR, MESH, **OPTIONS, output={"file": one, "independent_fields": True})
    ddic.measure(PAIR, MESH, regularization=OPTIONS["regularization"], solver={"method": "monolithic"},
                 output={"file": other})
    drawn = CliRunner().invoke(plot, [str(one), "--kind", "independent"])
    assert drawn.exit_code == 0, drawn.output
    assert (tmp_path / "one.independent.png").is_file()
    lacking = CliRunner().invoke(plot, [str(other), "--kind", "independent"])
    assert lacking.exit_code == 2
    assert "output.independent_fields = true" in lacking.stderr
    in_memory = ddic.measure(PAIR, MESH, **OPTIONS, output={"independent_fields": True})
    with pytest.raises(InputError, match="open the file that the measurement wrote"):
        in_memory.plot("independent")
    compared = CliRunner().invoke(plot, [str(one), "--kind", "difference", "--other", str(other)])
    assert compared.exit_code == 0, compared.output
    told = float(compared.output.split("Err ")[1].split()[0])
    u, v = (ddic.open(path).displacement for path in (one, other))
    np.testing.assert_allclose(told, np.linalg.norm(u - v) / np.linalg.norm(v), rtol=1e-3)


def test_what_cannot_be_kept_is_refused_or_told() -> None:
    with pytest.raises(InputError, match=r"output\.independent_fields does not go with \[pgd\]"):
        ddic.measure(PAIR, mesh={"structured": {"region": [16, 16, 176, 176], "element_size": 16}}, pgd={},
                     output={"independent_fields": True})
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        result = ddic.measure(PAIR, MESH, output={"independent_fields": True})
    assert any("output.independent_fields changes nothing here" in str(one.message) for one in told)
    assert "independent_displacement" not in result.point_data

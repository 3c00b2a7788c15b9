"""Strains at nodes: one value a node whatever the partition and the ranks, and nearer the truth than those of cells."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.io import result_schema as schema
from ddic.io.result_reader import Result, read_result
from ddic.kinematics.nodal import NodalRegion
from ddic.kinematics.nodal_gradients import recover_gradients
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.methods.run import run_case
from ddic.parallel.distribution import split_evenly
from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.results.fields import describe_nodal_strains, recover_nodal_gradients
from support.cases import WAVES, Ears, write_case, write_images

RANKS = [1, 3]
HOLED = build_structured_mesh((0, 0, 120, 120), 8, circles=[((70.0, 60.0), 22.0)])
MESHES = {"holed": HOLED, "cut": cut_mesh(HOLED, [np.array([[-5.0, 33.0], [101.0, 51.0]])]).mesh}
PLANE = [0, 1, 3]
NOISE = 6.0
"""Grey levels: without noise, the middle of a square has an exactness that no other point of it has."""


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
@pytest.mark.parametrize("n_subdomains", [4, 9])
def test_partition_and_ranks_change_rounding_alone(mesh: object, n_subdomains: int) -> None:
    team = Team(MPI.COMM_WORLD)
    u = np.random.default_rng(7).normal(size=mesh.nodes.shape)
    # Strips, then cells dealt like cards: nodes at the corners of four subdomains.
    for parts in (np.argsort(np.argsort(mesh.centroids[:, 0])) * n_subdomains // mesh.n_cells,
                  np.arange(mesh.n_cells) % n_subdomains):
        subdomains = build_subdomains(NodalRegion(mesh), parts, np.zeros(mesh.n_dofs, dtype=bool))
        mine = [subdomains[k] for k in split_evenly(np.ones(n_subdomains), team.size)[team.rank]]
        found = recover_nodal_gradients(team, mine, [u[s.node_ids].ravel() for s in mine])
        whole, = recover_gradients([mesh], [u.ravel()], list)
        for subdomain, gradients in zip(mine, found, strict=True):
            # Displacements of 1 px over parts of cells of a tenth of a pixel.
            np.testing.assert_allclose(gradients, whole[subdomain.node_ids], rtol=0, atol=1e-12)
        copies = team.gather_lists([(s.node_ids, g) for s, g in zip(mine, found, strict=True)])
        one = np.full(whole.shape, np.nan)
        for node_ids, gradients in copies:
            known = np.isfinite(one[node_ids])
            np.testing.assert_array_equal(gradients[known], one[node_ids][known])
            one[node_ids] = gradients


def _strain_of_waves(points: NDArray[np.float64]) -> NDArray[np.float64]:
    step = 1e-4
    by_x, by_y = ((WAVES.displacement(points + d) - WAVES.displacement(points - d)) / (2 * step)
                  for d in (np.array([step, 0.0]), np.array([0.0, step])))
    return np.stack([by_x[:, 0], by_y[:, 1], 0.5 * (by_x[:, 1] + by_y[:, 0])], axis=1)


def _errors(result: Result) -> tuple[float, float, float]:
    """RMS error of strains at all nodes, at those inside the region, and in the middle of cells."""
    nodes, middles = result.mesh.nodes, result.mesh.centroids
    at_nodes = result.point_data[schema.NODAL_INFINITESIMAL][:, PLANE] - _strain_of_waves(nodes)
    of_cells = result.cell_data[schema.STRAIN_INFINITESIMAL][:, PLANE] - _strain_of_waves(middles)
    inside = ((nodes > 25) & (nodes < 167)).all(axis=1)
    return _rms(at_nodes), _rms(at_nodes[inside]), _rms(of_cells)


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt((values**2).mean()))


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("method", ["[solver]\nsubdomains = 6\n", "[pgd]\noutput_spacing = 16\n"], ids=["dual", "pgd"])
def test_a_measured_field_has_better_strains_at_nodes(shared_path: Path, method: str) -> None:
    team = Team(MPI.COMM_WORLD)
    if team.is_root:
        write_images(shared_path)
        for name in "fg":
            image = tifffile.imread(shared_path / f"{name}.tif").astype(float)
            noise = np.random.default_rng(ord(name)).normal(0.0, NOISE, image.shape)
            tifffile.imwrite(shared_path / f"{name}.tif", np.clip(np.rint(image + noise), 0, 255).astype(np.uint8))
        write_case(shared_path, method)
    team.wait_for_all()
    run_case(team, shared_path / "case.toml", Ears())
    if not team.is_root:
        return
    path = shared_path / "result.vtkhdf"
    with h5py.File(path) as file:
        points = file[schema.POINT_DATA]
        numbers = points[schema.GLOBAL_NODE_ID][...]
        for spec in schema.nodal_strain_fields():
            values = points[spec.name][...]
            assert points[spec.name].attrs["unit"] == "1"
            first = np.unique(numbers, return_index=True)[1]
            # All copies of an interface node have one value.
            np.testing.assert_array_equal(values, values[first][numbers])
    result = read_result(path)
    everywhere, inside, of_cells = _errors(result)
    # Both see the same noise of the images; nodes average over more of it.
    assert inside <= of_cells
    # A third of these 100 nodes lie at an edge, where the functions of PGD-DIC are noisiest.
    assert everywhere <= (1.0 if result.separated is None else 1.2) * of_cells
    gradients, = recover_gradients([result.mesh], [result.displacement.ravel()], list)
    for name, values in describe_nodal_strains(gradients).items():
        # The file's are summed by subdomains.
        np.testing.assert_allclose(result.point_data[name], values, rtol=0, atol=1e-13, err_msg=name)

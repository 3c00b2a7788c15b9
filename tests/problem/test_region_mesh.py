"""The whole mesh: cameras, costs, controlled unknowns, and how it is cut."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from ddic.case.loader import load_case
from ddic.errors import InputError
from ddic.functionals.regularization import Material, measure_gap_energies
from ddic.inputs.cameras import open_cameras
from ddic.inputs.inputs import Inputs
from ddic.inputs.mesh_source import build_meshes
from ddic.io.image_file import open_image
from ddic.kinematics.linear import LinearRegion, TiedRegion
from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.topology import find_boundary_nodes
from ddic.parallel.team import Team
from ddic.partition.split import estimate_cell_costs
from ddic.problem.region_mesh import Region, RegionMesh, build_region_mesh, scatter_region, split_region
from support.cases import write_case, write_images
from support.near_far_cases import case_text as near_far_text
from support.near_far_cases import near_section, write_pairs
from support.pictures import square_mesh

RANKS = [1, 3]
REGULARIZED = '[regularization]\ncut_off_wavelength = 48.0\nnot_controlled = ["left"]\n'


def inputs_of(path: Path) -> Inputs:
    case = load_case(path).case
    cameras = open_cameras(case, open_image)
    image = cameras[0].reference.image
    return Inputs(case, cameras, lambda: build_meshes(case, image.extent))


def region_mesh_of(folder: Path, more: str = "") -> RegionMesh:
    if not (folder / "f.tif").exists():
        write_images(folder)
    return build_region_mesh(inputs_of(write_case(folder, more)))


def test_one_camera_measures_all_cells(tmp_path: Path) -> None:
    found = region_mesh_of(tmp_path)
    mesh = found.mesh
    assert isinstance(found.kinematics, NodalRegion)
    assert (mesh.n_nodes, mesh.n_cells, found.tying) == (100, 81, None)
    assert not found.cameras.any()
    np.testing.assert_array_equal(found.costs, estimate_cell_costs(mesh))
    (measured,) = found.measured
    assert measured.seen is mesh
    assert measured.cells.tolist() == list(range(81))
    outline = np.zeros(100, dtype=bool)
    outline[find_boundary_nodes(mesh)] = True
    np.testing.assert_array_equal(found.interior, ~outline)
    # Without regularization no row of equilibrium is kept.
    assert not found.controlled.any()


def test_edges_whose_forces_are_unknown_are_not_controlled(tmp_path: Path) -> None:
    found = region_mesh_of(tmp_path, REGULARIZED)
    left = np.repeat(found.mesh.nodes[:, 0] == 24.0, 2)
    assert left.sum() == 20
    np.testing.assert_array_equal(found.controlled, ~left)


def test_every_rank_is_told_the_sizes_and_the_energies_of_waves(tmp_path: Path) -> None:
    found = region_mesh_of(tmp_path, REGULARIZED)
    region = _describe(found)
    assert (region.n_nodes, region.n_cells, region.n_field, region.n_subdomains) == (100, 81, 200, 5)
    assert region.probe is not None
    assert region.probe.wavelength == 48.0
    # Sums of another order: 1e-13 of a sum of 300 terms that are not negative.
    np.testing.assert_allclose(region.probe.gap_energies,
                               measure_gap_energies(found.mesh, Material(), found.interior, 48.0), rtol=1e-13)
    of_eta = _describe(region_mesh_of(tmp_path, "[regularization]\neta = 2.0\n")).probe
    assert of_eta is not None
    # A quarter of the mesh's side of 9 elements of 16 px.
    assert of_eta.wavelength == 36.0
    assert _describe(region_mesh_of(tmp_path)).probe is None


def _describe(found: RegionMesh) -> Region:
    """What every rank is told where the mesh is cut into five."""
    parts = np.arange(found.mesh.n_cells) % 5
    return scatter_region(Team.alone(), found.inputs, found, parts)[1]


@pytest.mark.parametrize(("solver", "n_ranks", "n_parts"), [
    ("", 1, 1), ("", 3, 3), ("subdomains = 5", 2, 5), ('method = "monolithic"', 1, 1),
    ('partition = "blocks"\nblocks = [3, 2]', 1, 6), ('partition = "file"\npartition_file = "parts.txt"', 1, 3)])
def test_cells_are_split_as_the_case_says(tmp_path: Path, solver: str, n_ranks: int, n_parts: int) -> None:
    given = np.arange(81) % 3
    (tmp_path / "parts.txt").write_text("\n".join(str(s) for s in given), encoding="utf-8")
    found = region_mesh_of(tmp_path, f"[solver]\n{solver}\n")
    parts = split_region(found, n_ranks)
    assert sorted(set(parts.tolist())) == list(range(n_parts))
    if "file" in solver:
        np.testing.assert_array_equal(parts, given)


def test_subdomains_cost_what_their_cells_do(tmp_path: Path) -> None:
    found = region_mesh_of(tmp_path, "[solver]\nsubdomains = 5\n")
    parts = split_region(found, 1)
    subdomains, costs = found.cut(parts)
    assert [s.index for s in subdomains] == list(range(5))
    np.testing.assert_allclose(costs, [found.costs[s.cell_ids].sum() for s in subdomains], rtol=1e-14)
    for s in subdomains:
        np.testing.assert_array_equal(s.interior, found.interior[s.node_ids])
        assert (s.camera, s.motion) == (0, None)


@pytest.mark.parallel(RANKS)
def test_ranks_get_subdomains_and_the_same_region(shared_path: Path) -> None:
    team = Team.world()
    found = team.build_on_root(lambda: region_mesh_of(shared_path, "[solver]\nsubdomains = 5\n" + REGULARIZED))
    parts = None if found is None else split_region(found, team.size)
    inputs = inputs_of(shared_path / "case.toml")
    subdomains, region = scatter_region(team, inputs, found, parts)
    assert team.gather_lists([s.index for s in subdomains]) == list(range(5))
    everyone = team.gather_lists([region])
    assert all(other.n_subdomains == 5 for other in everyone)
    assert len({other.probe.gap_energies.tobytes() for other in everyone}) == 1


def test_a_near_camera_brings_its_motion_and_takes_its_cells(tmp_path: Path) -> None:
    write_pairs(tmp_path)
    path = tmp_path / "case.toml"
    path.write_text(near_far_text(near_section(more="use_far = true")), encoding="utf-8")
    found = build_region_mesh(inputs_of(path))
    assert set(found.cameras.tolist()) == {0, 1}
    assert [len(measured.cells) for measured in found.measured] == [(found.cameras == k).sum() for k in (0, 1)]
    near = found.measured[1]
    # The camera sees four times as large, and the far image counts as well.
    np.testing.assert_allclose(near.seen.nodes, found.inputs.cameras[1].setup.mapping.to_image(near.mesh.nodes))
    np.testing.assert_array_equal(found.costs[near.cells], estimate_cell_costs(near.seen) + 10 * 10)
    # Around the near field's nodes texture is not weighed against mechanics.
    assert not found.interior[np.unique(found.mesh.connectivity.reshape(-1, 4)[near.cells])].any()
    assert found.interior.any()
    subdomains, _ = scatter_region(Team.alone(), found.inputs, found, split_region(found, 1))
    assert [s.camera for s in subdomains] == sorted(s.camera for s in subdomains)
    assert {(s.camera, s.n_motion) for s in subdomains} == {(0, 0), (1, 2)}


def test_own_kinematics_have_the_rows_of_their_own_nodes(tmp_path: Path) -> None:
    write_images(tmp_path)
    inputs = inputs_of(write_case(tmp_path, REGULARIZED))
    chosen = []

    def choose(mesh: object) -> LinearRegion:
        region = LinearRegion(square_mesh(24.0, 168.0), sparse.identity(200, format="csr")[:, 5:])
        chosen.append(mesh)
        return region

    found = build_region_mesh(Inputs(inputs.case, inputs.cameras, inputs.build_mesh, choose))
    assert found.mesh is not chosen[0]
    assert found.describe(1).n_field == 195
    left = np.repeat(found.mesh.nodes[:, 0] == 24.0, 2)
    np.testing.assert_array_equal(found.controlled, ~left[5:])


def test_near_meshes_and_own_kinematics_exclude_each_other(tmp_path: Path) -> None:
    write_pairs(tmp_path)
    near_mesh = "[near.mesh.structured]\nregion = [130, 80, 170, 120]\nelement_size = 4\n"
    path = tmp_path / "case.toml"
    path.write_text(near_far_text(near_section() + near_mesh), encoding="utf-8")
    inputs = inputs_of(path)
    found = build_region_mesh(inputs)
    assert isinstance(found.kinematics, TiedRegion)
    assert found.tying is not None
    assert found.describe(1).n_field == 2 * found.tying.n_unknown_nodes < 2 * found.mesh.n_nodes
    with pytest.raises(InputError, match=r"leave near\.mesh or the kinematics out"):
        build_region_mesh(Inputs(inputs.case, inputs.cameras, inputs.build_mesh, NodalRegion))

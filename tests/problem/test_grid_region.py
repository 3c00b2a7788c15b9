"""A rectangle of equal cells, made where its subdomains are owned, is the mesh that rank 0 would have built."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mpi4py import MPI

from ddic.case.loader import load_case
from ddic.errors import InputError
from ddic.inputs.inputs import Inputs, open_inputs
from ddic.mesh.grid import GridBlock, GridLines
from ddic.mesh.raster import rasterize
from ddic.mesh.structured import build_grid_lines, build_structured_mesh
from ddic.parallel.team import Team
from ddic.partition.split import split_by_blocks, split_grid, split_grid_by_blocks
from ddic.partition.subdomain import Interface, Subdomain
from ddic.problem.grid_region import GridRegion, find_grid_region
from ddic.problem.region_mesh import build_region_mesh, finish_region, scatter_region
from support.cases import write_case, write_images

REGULARIZED = """
[regularization]
cut_off_wavelength = 48.0
not_controlled = ["left", "bottom"]
boxes = [[100, 100, 130, 200]]
"""
SIDES = st.tuples(st.integers(1, 12), st.integers(1, 12))


def number_of_cells(blocks: list[GridBlock], n_columns: int, n_rows: int) -> np.ndarray:
    """Subdomain of each cell, and -1 where none or several have it."""
    owners = np.zeros((n_rows, n_columns), np.int64) - 1
    for number, block in enumerate(blocks):
        columns, rows = block.ranges
        inside = owners[rows.start:rows.stop, columns.start:columns.stop]
        assert (inside == -1).all()
        inside[...] = number
    return owners.ravel()


@given(sides=SIDES, share=st.floats(0.0, 1.0))
def test_rectangles_cover_the_grid_once_and_are_as_many_as_asked_for(sides: tuple[int, int], share: float) -> None:
    n_columns, n_rows = sides
    grid = GridLines((np.arange(n_columns + 1.0), np.arange(n_rows + 1.0)))
    n = max(1, round(share * grid.n_cells))
    blocks = split_grid(grid, n)
    owners = number_of_cells(blocks, n_columns, n_rows)
    assert np.unique(owners).tolist() == list(range(n))


@pytest.mark.parametrize("n", [2, 3, 7, 16, 63, 64])
def test_rectangles_are_of_about_equal_size(n: int) -> None:
    blocks = split_grid(GridLines((np.arange(161.0), np.arange(121.0))), n)
    cells = np.array([block.n_cells for block in blocks])
    # Sides of 12 cells and more are cut to half a cell: 1 / 24 along each of both.
    assert np.abs(cells / cells.mean() - 1).max() <= 2 / 24
    sides = [list(map(len, block.ranges)) for block in blocks]
    assert max(max(along) / min(along) for along in sides) <= 2.5


@pytest.mark.parametrize("blocks", [(1, 1), (4, 3), (3, 5), (20, 2)])
def test_blocks_are_those_of_a_mesh(blocks: tuple[int, int]) -> None:
    region = (3.0, 5.0, 163.0, 101.0)
    grid = build_grid_lines(region, 10.0)
    found = number_of_cells(split_grid_by_blocks(grid, blocks), *grid.n_along)
    np.testing.assert_array_equal(found, split_by_blocks(build_structured_mesh(region, 10.0), blocks))


@pytest.mark.parametrize("region", [(3.0, 5.0, 163.0, 101.0), (-0.5, 0.5, 63.7, 31.2), (10.0, 10.0, 11.5, 50.0)])
def test_pixels_are_counted_as_rasters_count_them(region: tuple[float, float, float, float]) -> None:
    columns, rows = build_grid_lines(region, 1.7).count_pixels()
    expected = rasterize(build_structured_mesh(region, 1.7)).pixel_counts
    np.testing.assert_array_equal(np.outer(rows, columns).ravel(), expected)


def test_a_block_is_the_mesh_restricted_to_its_cells() -> None:
    region = (3.0, 5.0, 163.0, 101.0)
    mesh, grid = build_structured_mesh(region, 10.0), build_grid_lines(region, 10.0)
    for block in split_grid(grid, 7):
        found = grid.cut_block(block)
        expected, node_ids = mesh.create_submesh(found.cell_ids)
        np.testing.assert_array_equal(found.node_ids, node_ids)
        np.testing.assert_array_equal(found.mesh.nodes, expected.nodes)
        np.testing.assert_array_equal(found.mesh.connectivity, expected.connectivity)
        assert {name: nodes.tolist() for name, nodes in found.mesh.node_sets.items()} == {
            name: nodes.tolist() for name, nodes in expected.node_sets.items()}


def inputs_of(folder: Path, more: str = "", mesh: str | None = None) -> Inputs:
    if not (folder / "f.tif").exists():
        write_images(folder)
    path = write_case(folder, more)
    if mesh is not None:
        path.write_text(path.read_text().replace("[mesh.structured]", f"[mesh.structured]\n{mesh}"))
    return open_inputs(Team.alone(), load_case(path))[0]


def parts_of(region: GridRegion, n_ranks: int) -> np.ndarray:
    return number_of_cells(region.split(n_ranks), *region.grid.n_along)


def assert_same(found: Subdomain, expected: Subdomain) -> None:
    for field in fields(Subdomain):
        one, other = getattr(found, field.name), getattr(expected, field.name)
        if isinstance(one, Interface):
            for of_interface in fields(Interface):
                np.testing.assert_array_equal(getattr(one, of_interface.name), getattr(other, of_interface.name))
        elif field.name == "mesh":
            np.testing.assert_array_equal(one.nodes, other.nodes)
            np.testing.assert_array_equal(one.connectivity, other.connectivity)
        elif field.name == "kinematics":
            np.testing.assert_array_equal(one.numbers, other.numbers)
        else:
            np.testing.assert_array_equal(one, other, err_msg=field.name)


@pytest.mark.parallel([1, 2, 3, 4])
@pytest.mark.parametrize("solver", ["subdomains = 5", 'partition = "blocks"\nblocks = [3, 2]'])
def test_subdomains_are_those_that_rank_0_would_cut(shared_path: Path, solver: str) -> None:
    team = Team(MPI.COMM_WORLD)
    team.on_root(lambda: inputs_of(shared_path, f"{REGULARIZED}[solver]\n{solver}\n").case)
    inputs = open_inputs(Team.alone(), load_case(shared_path / "case.toml"))[0]
    grid = find_grid_region(inputs)
    assert grid is not None
    subdomains, region = finish_region(team, inputs, *grid.cut(team))
    whole = build_region_mesh(inputs)
    expected, known = scatter_region(Team.alone(), inputs, whole, parts_of(grid, team.size))
    for found in subdomains:
        assert_same(found, expected[found.index])
    assert team.gather_lists([s.index for s in subdomains]) == list(range(len(expected)))
    assert replace(region, probe=None) == replace(known, probe=None)
    assert region.probe is not None
    assert known.probe is not None
    np.testing.assert_array_equal(region.probe.gap_energies, known.probe.gap_energies)
    sizes, expected_sizes = grid.measure_sizes(), whole.measure_sizes()
    # A mean of areas: rounding alone.
    assert sizes.cell_size == pytest.approx(expected_sizes.cell_size, rel=1e-14)
    assert replace(sizes, cell_size=0.0) == replace(expected_sizes, cell_size=0.0)


@pytest.mark.parametrize(("more", "mesh"), [
    ("", 'cell = "T3"'), ("", "circles = [{center = [90, 90], radius = 30}]"),
    ('[solver]\npartition = "metis"\n', None),
    ("[[discontinuity]]\nvertices = [[10, 90], [180, 91]]\n", None)])
def test_other_meshes_are_built_whole(tmp_path: Path, more: str, mesh: str | None) -> None:
    assert find_grid_region(inputs_of(tmp_path, more, mesh)) is None


def test_a_grid_outside_the_image_and_too_many_subdomains_are_input_errors(tmp_path: Path) -> None:
    inputs = inputs_of(tmp_path, "[solver]\nsubdomains = 82\n")
    grid = find_grid_region(inputs)
    assert grid is not None
    with pytest.raises(InputError, match="81 cells for 82 subdomains"):
        grid.cut(Team.alone())
    section = inputs.case.mesh.structured
    assert section is not None
    outside = section.model_copy(update={"region": (24.0, 24.0, 500.0, 168.0)})
    case = inputs.case.model_copy(update={"mesh": inputs.case.mesh.model_copy(update={"structured": outside})})
    with pytest.raises(InputError, match="mesh lies outside the image"):
        find_grid_region(replace(inputs, case=case))

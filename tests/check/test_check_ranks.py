"""Ranks and subdomains."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import pytest

from ddic.api.given import make_case
from ddic.case.loader import LoadedCase, load_case
from ddic.check.case import check_case_file, check_mesh, load_checked_case
from ddic.check.ranks import check_ranks
from ddic.errors import InputError
from ddic.mesh.structured import build_structured_mesh
from support.cases import write_case, write_images


@pytest.mark.parametrize(("solver", "n_ranks", "fits"), [
    ("subdomains = 4", 4, True), ("subdomains = 4", 5, False), ("", 99, True),
    ('partition = "blocks"\nblocks = [2, 3]', 6, True), ('partition = "blocks"\nblocks = [2, 3]', 7, False),
    ('method = "monolithic"', 1, True), ('method = "monolithic"', 2, False),
])
def test_more_ranks_than_subdomains_are_refused(tmp_path: Path, solver: str, n_ranks: int, fits: bool) -> None:
    loaded = load_case(write_case(tmp_path, f"[solver]\n{solver}\n"))
    with nullcontext() if fits else pytest.raises(InputError, match=f"case.toml: .*{n_ranks}"):
        check_ranks(loaded, n_ranks)


@pytest.mark.parametrize(("solver", "most", "told"), [
    ("", 4, "case.toml: 4 cells of the mesh for 5 MPI ranks.*or use smaller elements"),
    ('partition = "blocks"\nblocks = [4, 1]', 2, "case.toml: solver.blocks: 2 blocks with cells for 3 MPI ranks"),
    ('partition = "file"\npartition_file = "parts.txt"', 3, "parts.txt: 3 subdomains for 4 MPI ranks"),
    ("subdomains = 3", 3, "solver.subdomains: 3 subdomains for 4 MPI ranks"),
])
def test_check_says_how_many_ranks_a_mesh_bears(tmp_path: Path, solver: str, most: int, told: str) -> None:
    write_images(tmp_path)
    (tmp_path / "parts.txt").write_text("0 1 2 2\n", encoding="utf-8")
    path = write_case(tmp_path, f"[solver]\n{solver}\n")
    text = path.read_text(encoding="utf-8").replace("element_size = 16", "element_size = 72")
    path.write_text(text, encoding="utf-8")
    assert check_case_file(path).most_ranks == most
    load_checked_case(path, most)
    with pytest.raises(InputError, match=told):
        load_checked_case(path, most + 1)


def test_more_ranks_than_cells_are_refused_in_python_too() -> None:
    mesh = build_structured_mesh((10, 10, 90, 90), 40)
    options = LoadedCase(make_case({}), Path("options"), "")
    check_mesh(options, mesh, 4)
    with pytest.raises(InputError, match="options: 4 cells of the mesh for 6 MPI ranks, but every rank needs at least "
                                         "one; start at most 4 ranks or use smaller elements"):
        check_mesh(options, mesh, 6)

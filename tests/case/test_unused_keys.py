"""Keys that are right and change nothing are told; those that do something are not."""

from __future__ import annotations

from pathlib import Path

import pytest

from ddic.case.loader import list_unused_keys, load_case, load_case_leniently

INPUTS = ('[images]\nreference = "f.tif"\ndeformed = "g.tif"\n[mesh.structured]\nregion = [0, 0, 50, 50]\n'
          "element_size = 10\n")


@pytest.mark.parametrize(("text", "keys"), [
    ("", []),
    ('[solver]\nmethod = "assembled"\nsubdomains = 4\nthreads = 2\n', []),
    ('[solver]\nmethod = "conjugate_gradient"\ntolerance = 1e-8\n', []),
    ("[solver]\nrecycle = false\nlocal_inverse = \"dense\"\n[start]\nfeatures = false\nrigid = false\n", []),
    ('[solver]\nmethod = "conjugate_gradient"\npreconditioner = "scaled"\n', ["solver.preconditioner"]),
    ('[solver]\nmethod = "assembled"\nmax_iterations = 10\nrecycle = true\n',
     ["solver.recycle", "solver.max_iterations"]),
    ('[solver]\nmethod = "monolithic"\nsubdomains = 4\n', ["solver.subdomains"]),
    ('[start]\nfrom_result = "r.vtkhdf"\npyramid = false\nindependent = false\n', ["start.pyramid"]),
    ("[start]\nrigid = false\nfeatures = true\n", ["start.features"]),
    ("[start]\nlargest_enriched_block = 8.0\n", ["start.largest_enriched_block"]),
    ('[solver]\nmethod = "assembled"\n[start]\nindependent = true\n', ["start.independent"]),
])
def test_unused_keys_are_listed(tmp_path: Path, text: str, keys: list[str]) -> None:
    (tmp_path / "case.toml").write_text(INPUTS + text)
    lines = list_unused_keys(load_case(tmp_path / "case.toml").case)
    assert [line.split(" changes nothing here: it goes with ")[0] for line in lines] == keys


@pytest.mark.parametrize("is_asked_for", [False, True])
def test_noise_is_used_for_uncertainties(tmp_path: Path, *, is_asked_for: bool) -> None:
    text = INPUTS.replace("[mesh", "noise = 2.0\n[mesh", 1) + f"[output]\nuncertainty = {str(is_asked_for).lower()}\n"
    (tmp_path / "case.toml").write_text(text)
    assert len(list_unused_keys(load_case(tmp_path / "case.toml").case)) == (0 if is_asked_for else 1)


def test_what_is_left_of_a_case_without_its_bad_keys(tmp_path: Path) -> None:
    path = tmp_path / "case.toml"
    path.write_text(INPUTS + '[solver]\nsubdomain = 4\nmethod = "dual"\ntolerance = "small"\n[strat]\nrigid = true\n')
    loaded, problems = load_case_leniently(path)
    assert len(problems) == 3
    assert loaded is not None
    assert loaded.case.images.reference == tmp_path / "f.tif"
    assert loaded.case.solver.tolerance == 1e-6


@pytest.mark.parametrize("text", ["[images\n", "", INPUTS.replace('reference = "f.tif"\n', ""),
                                  INPUTS.replace("[0, 0, 50, 50]", "[0, 0, 50]")])
def test_nothing_is_left_where_needed_keys_are_bad(tmp_path: Path, text: str) -> None:
    (tmp_path / "case.toml").write_text(text)
    loaded, problems = load_case_leniently(tmp_path / "case.toml")
    assert loaded is None
    assert problems


def test_missing_files_are_told_beside_keys_that_nothing_can_be_done_without(tmp_path: Path) -> None:
    (tmp_path / "f.tif").touch()
    text = INPUTS.replace("element_size = 10", 'element_size = "10"') + '[output]\nfile = "r.vtkhdf"\n'
    near = '[[near]]\nreference = "n.tif"\ndeformed = "f.tif"\nratio = 4\n'
    (tmp_path / "case.toml").write_text(text + near)
    loaded, problems = load_case_leniently(tmp_path / "case.toml")
    assert loaded is None
    words = ['element_size = "10": expected a number', "near.ratio", f"{tmp_path / 'g.tif'}: no such file",
             f"{tmp_path / 'n.tif'}: no such file"]
    assert len(problems) == len(words)
    assert all(any(word in line for line in problems) for word in words), problems

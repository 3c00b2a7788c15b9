"""What [pgd] refuses beside itself, each in one line with a remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from ddic.case.loader import load_case, parse_case_text
from ddic.check.case import check_case
from ddic.check.ranks import check_ranks
from ddic.errors import InputError
from support.cases import REGION, case_text, write_case, write_images

NEAR = '[[near]]\nreference = "a.tif"\ndeformed = "b.tif"\nratio = 4\noffset = [0, 0]\n'


@pytest.mark.parametrize(("more", "words"), [
    (NEAR, "[[near]] does not go with [pgd]; measure one image pair at a time"),
    ("[[discontinuity]]\nvertices = [[0, 0], [9, 9]]\n", "[[discontinuity]] does not go with [pgd]; leave [pgd] out"),
    ('[solver]\nmethod = "assembled"\n', "[solver] does not go with [pgd]; leave it out"),
    ("[gauss_newton]\ntolerance = 1e-4\n", "[gauss_newton] does not go with [pgd]; give pgd.tolerance"),
    ('[correlation]\ngrey_correction = "element"\n', '"element" does not go with [pgd]; use "global"'),
    ("[start]\nindependent = true\n", "start.independent does not go with [pgd]; leave it out"),
    ("[start]\nlargest_enriched_block = 8\n", "start.largest_enriched_block does not go with [pgd]"),
    ("[regularization]\neta = 1\nboxes = [[0, 0, 9, 9]]\n", "regularization.boxes does not go with [pgd]; name whole"),
    ('[regularization]\neta = 1\noperator = "tikhonov"\nplane = "strain"\n',
     'regularization.plane goes with regularization.operator = "equilibrium_gap"'),
])
def test_what_makes_no_sense_beside_pgd_is_refused(more: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_case_text(case_text(f"[pgd]\n{more}"), Path("case.toml"))
    (line,) = caught.value.problems
    assert words in line
    assert line.startswith("case.toml: ")


def test_tikhonov_needs_pgd() -> None:
    with pytest.raises(InputError, match=r'operator = "tikhonov" goes with \[pgd\]'):
        parse_case_text(case_text('[regularization]\ncut_off_wavelength = 60\noperator = "tikhonov"\n'),
                        Path("case.toml"))


@pytest.mark.parametrize(("region", "more", "words"), [
    (f'{REGION}\ncell = "T3"', "", 'mesh.structured.cell = "T3": [pgd] measures on "Q4" elements'),
    (f"{REGION}\ncircles = [{{ center = [96, 96], radius = 9 }}]", "",
     "mesh.structured.circles: [pgd] measures whole rectangles; leave pixels out by images.reference_mask"),
    ("region = [24, 24, 268, 168]", "", "the mesh lies outside the image"),
    (REGION, "output_spacing = 5\n", "pgd.output_spacing = 5: smaller than the elements, of 16 px"),
    (REGION, "[regularization]\ncut_off_wavelength = 40\n", "carries no wave shorter than 3 elements"),
    (REGION, '[regularization]\neta = 1\nnot_controlled = ["hole_0"]\n',
     'regularization.not_controlled: "hole_0" is no side of a rectangle; there are left, right, top, bottom'),
])
def test_rectangle_is_checked(tmp_path: Path, region: str, more: str, words: str) -> None:
    write_images(tmp_path)
    loaded = load_case(write_case(tmp_path, f"[pgd]\n{more}", region=region))
    with pytest.raises(InputError) as caught:
        check_case(loaded)
    (line,) = caught.value.problems
    assert words in line
    assert line.startswith(f"{loaded.path}: ")


def test_small_elements_and_mesh_files_are_refused(tmp_path: Path) -> None:
    write_images(tmp_path)
    path = write_case(tmp_path, "[pgd]\n")
    path.write_text(path.read_text().replace("element_size = 16", "element_size = 0.5"))
    with pytest.raises(InputError, match=r"element_size = 0.5: smaller than a pixel; give 1 or more"):
        check_case(load_case(path))
    path.write_text('[images]\nreference = "f.tif"\ndeformed = "g.tif"\n[mesh]\nfile = "a.msh"\n[pgd]\n')
    with pytest.raises(InputError, match=r"mesh.file: \[pgd\] measures on a rectangle"):
        check_case(load_case(path))


def test_more_ranks_than_bands_are_refused(tmp_path: Path) -> None:
    write_images(tmp_path)
    loaded = load_case(write_case(tmp_path, "[pgd]\n"))
    check_ranks(loaded, 16)
    with pytest.raises(InputError, match="16 bands, and 17 MPI ranks were started; start at most 16"):
        check_ranks(loaded, 17)


def test_report_counts_what_is_not_listed(tmp_path: Path) -> None:
    write_images(tmp_path)
    path = write_case(tmp_path, '[pgd]\n[regularization]\ncut_off_wavelength = 64\nnot_controlled = ["left"]\n')
    path.write_text(path.read_text().replace("element_size = 16", "element_size = 1"))
    report = check_case(load_case(path))
    assert (report.n_nodes, report.n_cells, report.n_dofs) == (145**2, 144**2, 2 * 145**2)
    assert report.n_controlled_dofs == 2 * 144 * 145
    assert (report.pixels_min, report.pixels_mean) == (1, 1.0)

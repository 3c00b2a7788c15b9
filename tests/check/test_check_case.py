"""Validation of all inputs, and the command that prints it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from ddic.case.loader import load_case
from ddic.check.case import CheckReport, check_case
from ddic.cli.check import check
from ddic.errors import InputError
from ddic.images.window import Window
from ddic.inputs.mesh_source import build_meshes
from ddic.io.text_files import read_partition

IMAGES = '[images]\nreference = "f.tif"\ndeformed = "g.tif"\n'
GRID = "[mesh.structured]\nregion = [10, 10, 90, 70]\nelement_size = 10\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a pair of 16-bit images of 100x80 pixels."""
    grey = np.random.default_rng(1).integers(0, 60000, (80, 100)).astype(np.uint16)
    for name in ("f.tif", "g.tif"):
        tifffile.imwrite(tmp_path / name, grey)
    return tmp_path


def _check(folder: Path, text: str) -> CheckReport:
    (folder / "case.toml").write_text(text)
    return check_case(load_case(folder / "case.toml"))


def _problems(folder: Path, text: str) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        _check(folder, text)
    return caught.value.problems


def test_report_of_a_sound_case(folder: Path) -> None:
    report = _check(folder, IMAGES + GRID + '[regularization]\neta = 1\nnot_controlled = ["left"]\n')
    assert report.image_size == (100, 80)
    assert report.bits == 16
    assert (report.n_nodes, report.n_cells, report.n_dofs) == (63, 48, 126)
    assert report.cell_counts == {"Q4": 48}
    assert report.node_sets == {"left": 7, "right": 7, "top": 9, "bottom": 9}
    assert (report.pixels_min, report.pixels_mean) == (100, 100.0)
    assert report.n_controlled_dofs == 126 - 14
    assert report.output == folder / "result.vtkhdf"


def test_without_regularization_nothing_is_controlled(folder: Path) -> None:
    assert _check(folder, IMAGES + GRID).n_controlled_dofs == 0


def test_problems_of_all_inputs_at_once(folder: Path) -> None:
    (folder / "parts.txt").write_text("0 1 2\n")
    (folder / "old.vtkhdf").write_text("no result")
    tifffile.imwrite(folder / "mask.tif", np.ones((80, 99), dtype=np.uint8))
    found = _problems(folder, IMAGES + 'reference_mask = "mask.tif"\n' + GRID
                      + '[regularization]\neta = 1\nnot_controlled = ["lefft"]\nboxes = [[1, 1, 2, 2]]\n'
                      + '[solver]\npartition = "file"\npartition_file = "parts.txt"\n'
                      + '[start]\nfrom_result = "old.vtkhdf"\n[output]\nfile = "none/r.vtkhdf"\n')
    words = ["mask.tif: the mask is 99 x 80 px, but its image is 100 x 80 px",
             "case.toml: output.file: there is no folder",
             "old.vtkhdf", 'no node set is named "lefft"; did you mean "left"?', "regularization.boxes",
             "parts.txt: holds 3 numbers, but the mesh has 48 cells"]
    assert len(found) == len(words)
    for line, word in zip(found, words, strict=True):
        assert word in line
        assert "\n" not in line


def test_missing_images_and_output_are_reported_together(folder: Path) -> None:
    found = _problems(folder, IMAGES.replace("f.tif", "x.tif") + GRID + '[output]\nfile = "."\n')
    assert len(found) == 2
    assert "x.tif" in found[0]
    assert "is a folder" in found[1]


def test_missing_reference_image_does_not_hide_node_sets(folder: Path) -> None:
    text = IMAGES.replace("f.tif", "x.tif") + GRID + '[regularization]\neta = 1\nnot_controlled = ["lefft"]\n'
    found = _problems(folder, text)
    assert len(found) == 2
    assert "x.tif" in found[0]
    assert '"lefft"' in found[1]
    # A mesh of which nothing can be said without the image is not complained of.
    (line,) = _problems(folder, text.replace("element_size = 10", 'element_size = 10\nmask = "x.tif"'))
    assert "x.tif: no such image file" in line


def test_mesh_outside_the_image_does_not_hide_node_sets(folder: Path) -> None:
    found = _problems(folder, IMAGES + GRID.replace("90", "190")
                      + '[regularization]\neta = 1\nnot_controlled = ["lefft"]\n[solver]\nsubdomains = 5000\n')
    assert [line.rpartition("case.toml: ")[2].split(":")[0] for line in found] == [
        "mesh.structured", "regularization.not_controlled", "solver.subdomains = 5000"]


def test_missing_deformed_image_does_not_hide_the_mesh(folder: Path) -> None:
    found = _problems(folder, IMAGES.replace("g.tif", "y.tif") + GRID.replace("90", "190"))
    assert len(found) == 2
    assert "y.tif" in found[0]
    assert found[1].startswith("mesh.structured: the mesh lies outside the image")


def test_images_of_different_size(folder: Path) -> None:
    tifffile.imwrite(folder / "g.tif", np.eye(80, 101, dtype=np.uint16))
    (line,) = _problems(folder, IMAGES + GRID)
    assert "g.tif: the image is 101x80 px, but the reference" in line


def test_nan_is_refused_unless_masked(folder: Path) -> None:
    grey = np.eye(80, 100, dtype=np.float32)
    grey[20, 30] = np.nan
    tifffile.imwrite(folder / "f.tif", grey)
    (line,) = _problems(folder, IMAGES + GRID)
    assert "f.tif" in line
    assert "NaN" in line
    mask = np.full((80, 100), 255, dtype=np.uint8)
    mask[20, 30] = 0
    cv2.imwrite(str(folder / "mask.png"), mask)
    assert _check(folder, IMAGES + 'reference_mask = "mask.png"\n' + GRID).bits is None


def test_zero_pixel_cells(folder: Path) -> None:
    (line,) = _problems(folder, IMAGES + "[mesh.structured]\nregion = [10.1, 10.1, 11.3, 20.1]\nelement_size = 0.6\n")
    # Two columns of 0.6 px: 10.1-10.7 holds no whole number.
    assert "mesh.structured: " in line
    assert "hold no pixel" in line


def test_too_many_subdomains(folder: Path) -> None:
    (line,) = _problems(folder, IMAGES + GRID + "[solver]\nsubdomains = 49\n")
    assert "case.toml: solver.subdomains = 49: the mesh has only 48 cells" in line


def test_mesh_file_and_mapping(folder: Path) -> None:
    (folder / "a.inp").write_text("*NODE\n1, 0., 0.\n2, 1., 0.\n3, 1., 1.\n4, 0., 1.\n"
                                  "*ELEMENT, TYPE=CPS4\n1, 4, 3, 2, 1\n")
    text = IMAGES + '[mesh]\nfile = "a.inp"\n'
    report = _check(folder, text + "mapping = { scale = 40, translation = [20, 30] }\n")
    assert report.pixels_mean == 1600
    (line,) = _problems(folder, text + "mapping = { scale = 90 }\n")
    assert "a.inp: the mesh lies outside the image: nodes from (0, 0) to (90, 90) px, image 100 x 80 px" in line


def test_structured_mesh_with_mask_and_holes(folder: Path) -> None:
    mask = np.full((80, 100), 255, dtype=np.uint8)
    mask[:, :30] = 0
    cv2.imwrite(str(folder / "mask.png"), mask)
    (folder / "case.toml").write_text(IMAGES + GRID + 'mask = "mask.png"\n'
                                      "circles = [{ center = [60, 40], radius = 15 }]\n"
                                      "polygons = [{ vertices = [[70, 55], [90, 55], [90, 70], [70, 70]] }]\n")
    mesh, _ = build_meshes(load_case(folder / "case.toml").case, Window.of_size(100, 80))
    assert mesh.nodes[:, 0].min() == 30
    away = np.hypot(*(mesh.nodes[mesh.node_sets["hole_0"]] - [60, 40]).T)
    np.testing.assert_allclose(away, 15, rtol=1e-12)
    assert len(mesh.node_sets["hole_1"]) > 0


def test_structured_mesh_snapped_to_a_mask(folder: Path) -> None:
    mask = np.full((80, 100), 255, dtype=np.uint8)
    mask[33:58, 42:73] = 0
    cv2.imwrite(str(folder / "mask.png"), mask)
    (folder / "case.toml").write_text(IMAGES + GRID + 'mask = "mask.png"\nmask_outline = "snapped"\n')
    mesh, _ = build_meshes(load_case(folder / "case.toml").case, Window.of_size(100, 80))
    found = mesh.nodes[mesh.node_sets["hole_0"]]
    # The edges of the pixels that are left out, to the last digit, and their four corners.
    assert (found.min(axis=0).tolist(), found.max(axis=0).tolist()) == ([41.5, 32.5], [72.5, 57.5])
    corners = {(x, y) for x in (41.5, 72.5) for y in (32.5, 57.5)}
    assert corners <= {tuple(node) for node in found.tolist()}


@pytest.mark.parametrize(("text", "words"), [
    ("0 1 x 1", '"x" is not a subdomain'), ("0 -1 1 1", '"-1" is not a subdomain'), ("0 1 1", "holds 3 numbers"),
    ("0 2 2 0", "subdomain 1 has no cell"),
])
def test_bad_partition_files(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "p.txt").write_text(text)
    with pytest.raises(InputError, match=words):
        read_partition(tmp_path / "p.txt", 4)


def test_partition_file(tmp_path: Path) -> None:
    (tmp_path / "p.txt").write_text("# four cells\n1 0\n1\n2 # the last\n")
    assert read_partition(tmp_path / "p.txt", 4).tolist() == [1, 0, 1, 2]
    with pytest.raises(InputError, match="cannot read this partition file"):
        read_partition(tmp_path / "none.txt", 4)


def test_command_prints_the_report(folder: Path) -> None:
    (folder / "case.toml").write_text(IMAGES + GRID)
    done = CliRunner().invoke(check, [str(folder / "case.toml")])
    assert done.exit_code == 0
    assert "100 x 80 px, 16 bit" in done.output
    assert "63 nodes, 48 cells (48 Q4)" in done.output


def test_command_lists_problems_on_standard_error(folder: Path) -> None:
    (folder / "case.toml").write_text(IMAGES.replace("f.tif", "x.tif") + GRID + '[output]\nfile = "."\n')
    done = CliRunner().invoke(check, [str(folder / "case.toml")])
    assert done.exit_code == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 2


def test_command_refuses_a_missing_case(tmp_path: Path) -> None:
    done = CliRunner().invoke(check, [str(tmp_path / "none.toml")])
    assert done.exit_code == 2
    assert "none.toml: cannot read this case file" in done.stderr


def test_colour_images_are_announced(folder: Path) -> None:
    red = np.full((80, 100, 3), (0, 0, 200), dtype=np.uint8)
    red[:, ::2] = 0
    cv2.imwrite(str(folder / "f.png"), red)
    (folder / "case.toml").write_text(IMAGES.replace("f.tif", "f.png") + GRID)
    done = CliRunner().invoke(check, [str(folder / "case.toml")])
    assert done.exit_code == 0
    assert "warning: " in done.stderr
    assert "colour" in done.stderr


@pytest.mark.parametrize("kept", ["r.not_converged.tif", "r.earlier.tif", "r.physical.vtkhdf",
                                  "r.not_converged.physical.vtkhdf", "r.earlier.physical.vtkhdf"])
def test_what_stands_beside_a_result_or_a_failed_run_may_not_overwrite_an_input(folder: Path, kept: str) -> None:
    (folder / "g.tif").rename(folder / kept)
    (line,) = _problems(folder, IMAGES.replace("g.tif", kept) + GRID + '[output]\nfile = "r.tif"\n')
    assert f"would overwrite the input {folder / kept}" in line


@pytest.mark.parametrize(("name", "input_"), [
    ("g.tif", "g.tif"), ("case.toml", "case.toml"), ("part.txt", "part.txt"), ("points.csv", "points.csv"),
    ("g.residual.tif", None),
])
def test_the_result_may_not_overwrite_an_input(folder: Path, name: str, input_: str | None) -> None:
    (folder / "part.txt").write_text("0\n" * 48)
    (folder / "points.csv").write_text("x,y,u,v\n40,40,0,0\n")
    text = (IMAGES + GRID + '[solver]\npartition = "file"\npartition_file = "part.txt"\n'
            + '[start]\nfrom_points = "points.csv"\n' + f'[output]\nfile = "{name}"\n')
    if input_ is None:
        assert _check(folder, text).output == folder / name
        return
    problems = _problems(folder, text)
    assert len(problems) == 1
    assert f"would overwrite the input {folder / input_}" in problems[0]


@pytest.mark.parametrize("given", ["", "."])
def test_a_folder_in_place_of_an_image_is_one_problem(folder: Path, given: str) -> None:
    # Of volumes it may be a folder of slices, into which no result is written.
    (line,) = _problems(folder, IMAGES.replace("g.tif", given) + GRID)
    assert "is a folder, no such image file" in line


@pytest.mark.parametrize(("start", "is_lost"), [("r.vtkhdf", True), ("link.vtkhdf", True), ("r.earlier.vtkhdf", True),
                                                ("r.frames/000001.vtkhdf", True),
                                                ("r.not_converged.vtkhdf", False)])
def test_the_result_may_not_overwrite_what_the_case_starts_from(folder: Path, start: str, *, is_lost: bool) -> None:
    (folder / start).parent.mkdir(exist_ok=True)
    (folder / start).write_bytes(b"no result, which is another problem")
    if start.startswith("link"):
        (folder / "r.vtkhdf").symlink_to(folder / start)
    problems = _problems(folder, f'{IMAGES}{GRID}[start]\nfrom_result = "{start}"\n[output]\nfile = "r.vtkhdf"\n')
    assert any(f"would overwrite the input {folder / start}" in problem for problem in problems) is is_lost


def test_the_result_may_not_take_the_summary_s_name(folder: Path) -> None:
    problems = _problems(folder, IMAGES + GRID + '[output]\nfile = "x.json"\n')
    assert "is the name of the summary" in problems[0]


@pytest.mark.parametrize("noise", ["1e308", "1e-300"])
def test_a_noise_that_no_image_has_is_refused(folder: Path, noise: str) -> None:
    (line,) = _problems(folder, f"{IMAGES}noise = {noise}\n{GRID}")
    assert line.startswith(f"{folder / 'f.tif'}: noise = {noise.replace('e', 'e+' if '-' not in noise else 'e')}: grey")
    assert "levels of this image span 65535; give the standard deviation of its noise, from 0.0066 to 6.6e+04" in line


def test_an_image_of_a_few_pixels_is_told_once(folder: Path) -> None:
    tifffile.imwrite(folder / "f.tif", np.arange(16, dtype=np.uint8).reshape(4, 4))
    assert _problems(folder, IMAGES + GRID) == (
        f"{folder / 'f.tif'}: the image is 4x4 px: too small to measure on; give one of 8x8 px at least",)


def test_a_result_that_is_a_link_in_circles_is_refused(folder: Path) -> None:
    (folder / "r.vtkhdf").symlink_to(folder / "r.vtkhdf")
    (line,) = _problems(folder, f'{IMAGES}{GRID}[output]\nfile = "r.vtkhdf"\n')
    assert "is a link that leads in circles" in line


@pytest.mark.parametrize(("wavelength", "words"), [(29.0, "no wave shorter than 3 elements; give at least 30"),
                                                   (1.1e4, "rounding hides the images")])
def test_wavelengths_that_the_mesh_cannot_carry_are_refused(folder: Path, wavelength: float, words: str) -> None:
    text = IMAGES + GRID + "[regularization]\ncut_off_wavelength = {}\n"
    problems = _problems(folder, text.format(wavelength))
    assert len(problems) == 1
    assert problems[0].startswith(f"{folder / 'case.toml'}: regularization.cut_off_wavelength = ")
    assert words in problems[0]
    _check(folder, text.format(30.0))
    _check(folder, text.format(1e4))


GRID_CASES = ["", "[regularization]\ncut_off_wavelength = 40\n",
              '[regularization]\ncut_off_wavelength = 40\nnot_controlled = ["left", "top"]\n',
              '[regularization]\neta = 2\nnot_controlled = ["boundary"]\nboxes = [[20, 30, 51, 41], [9, 9, 99, 26]]\n',
              '[regularization]\neta = 2.0\nnot_controlled = ["lift"]\nboxes = [[25, 25, 29, 29], [500, 0, 600, 9]]\n',
              "[regularization]\ncut_off_wavelength = 8\n", "[regularization]\neta = 1e30\n",
              "[start]\npoints = [[50, 50, 51, 51]]\n", "[start]\npoints = [[3, 3, 4, 4]]\n"]


@pytest.mark.parametrize("more", GRID_CASES)
def test_a_grid_is_checked_as_the_mesh_that_nobody_builds(folder: Path, more: str) -> None:
    # A mesh for METIS is built.
    found, expected = (_report_or_problems(folder, f'{IMAGES}{GRID}{more}[solver]\npartition = "{partition}"\n')
                       for partition in ("auto", "metis"))
    assert found == expected


@pytest.mark.parametrize("solver", ["subdomains = 49", "subdomains = 5", 'method = "monolithic"',
                                    'partition = "blocks"\nblocks = [3, 2]', 'partition = "blocks"\nblocks = [9, 6]'])
def test_a_grid_has_as_many_subdomains_at_most_as_its_mesh(folder: Path, solver: str) -> None:
    # A mask of everything, which has the mesh built.
    tifffile.imwrite(folder / "all.tif", np.ones((80, 100), np.uint8))
    found, expected = (_report_or_problems(folder, f"{IMAGES}{GRID}{mask}[solver]\n{solver}\n")
                       for mask in ("", 'mask = "all.tif"\n'))
    assert found == expected


def _report_or_problems(folder: Path, text: str) -> CheckReport | list[str]:
    try:
        return _check(folder, text)
    except InputError as error:
        return error.problems

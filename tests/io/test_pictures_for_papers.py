"""Pictures that go into a paper: nothing clipped, nothing folded, colours and numbers that say what is measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from matplotlib import colormaps
from matplotlib.figure import Figure

from accept.report_page import find_clipped_texts
from ddic.cli.check import check
from ddic.cli.plot import plot
from ddic.errors import InputError
from ddic.io.image_file import open_image
from ddic.io.result_reader import Result, read_result
from ddic.io.result_schema import LOOK, NODAL_INFINITESIMAL, Verdict
from ddic.kinematics.strain import count_folded_cells
from ddic.mesh.structured import build_structured_mesh
from ddic.plots.canvas import PIXELS, ColourScale, LengthUnit, format_title, make_image_figure
from ddic.plots.curves import draw_krylov
from ddic.plots.figures import Drawing, Look, draw
from ddic.plots.maps import (
    Preview,
    StrainChoice,
    compute_difference,
    draw_deformed,
    draw_difference,
    draw_displacement,
    draw_near_far,
    draw_residual,
    draw_strain,
    find_shared_view,
)
from ddic.plots.partition import PALETTE, choose_colours, draw_mesh_preview, draw_partition
from support.cases import write_case, write_images

Write = Callable[..., Path]
MM = LengthUnit(0.0123, "mm")
SHAPES = {"as it is": (1.0, 1.0), "tall": (0.1, 3.0), "flat": (30.0, 0.5), "far": (400.0, 400.0)}
LONG_NAME = "a_result_whose_name_is_as_long_as_people_make_them_when_they_number_specimens.vtkhdf"


@pytest.fixture
def result(tmp_path: Path, write_result: Write) -> Result:
    return read_result(write_result(tmp_path / "r.vtkhdf"))


def shaped(result: Result, shape: str) -> Result:
    """The result on a mesh of other proportions, with strain at nodes, a second camera and a long name."""
    mesh = replace(result.mesh, nodes=result.mesh.nodes * SHAPES[shape])
    strain = np.tile(np.array([1.0, -2.0, 0.0, 0.5, 0.0, 0.0]), (mesh.n_nodes, 1)) * mesh.nodes[:, :1] * 1e-5
    camera = (mesh.centroids[:, 0] < np.median(mesh.centroids[:, 0])).astype(np.int32)
    return replace(result, mesh=mesh, point_data={**result.point_data, NODAL_INFINITESIMAL: strain},
                   cell_data={**result.cell_data, "Camera": camera},
                   attributes={**result.attributes, "near_1": {"alpha_px": np.array([-101.25, -0.5])}})


def figures(result: Result, unit: LengthUnit) -> dict[str, Figure]:
    width, height = (np.ceil(result.mesh.nodes.max(axis=0)) + 20).astype(int)
    image = Preview(np.zeros((9, 9)), int(max(width, height) // 9 + 1), int(width), int(height))
    sets = {name: np.arange(3) for name in ("left", "a_name_of_a_set_that_nobody_would_type")}
    line = np.array([[5.0, 9.0], [9.0, 5.0]])
    return {
        "partition": draw_partition(result, image, unit),
        "deformed": draw_deformed(result, "x", None, unit),
        "amplified": draw_deformed(result, "magnitude", 1e5, unit),
        "displacement": draw_displacement(result, image, "magnitude", unit),
        "strain": draw_strain(result, StrainChoice(), image, unit),
        "one strain": draw_strain(result, StrainChoice("hencky", "von-mises", by_cell=True), None, unit,
                                  [ColourScale((-1e-7, 1e-7))]),
        "residual": draw_residual(result, unit=unit),
        "signed": draw_residual(result, signed=True, unit=unit),
        "difference": draw_difference(compute_difference(result, result), "y", unit),
        "krylov": draw_krylov({result.path.name: result.krylov, "b": result.krylov * 9}),
        "near-far": draw_near_far(result, "magnitude", unit),
        "mesh": draw_mesh_preview(replace(result.mesh, node_sets=sets), image, [line]),
    }


@pytest.mark.parametrize("unit", [LengthUnit(), MM], ids=["px", "mm"])
@pytest.mark.parametrize("shape", SHAPES)
def test_no_text_is_clipped(tmp_path: Path, write_result: Write, shape: str, unit: LengthUnit) -> None:
    result = read_result(write_result(tmp_path / LONG_NAME))
    for name, figure in figures(shaped(result, shape), unit).items():
        assert find_clipped_texts(figure) == [], name


def test_clipped_texts_are_found() -> None:
    figure, axes = make_image_figure((0, 0, 10, 10), "short")
    assert find_clipped_texts(figure) == []
    axes.set_title("a title that is much longer than a page of seven inches is wide, in a type of eleven points, cut")
    assert find_clipped_texts(figure) == [axes.get_title()]
    axes.set_title("short")
    axes.set_ylabel("height", labelpad=60)
    assert find_clipped_texts(figure) == ["height", "axis height"]


def test_titles_are_broken_between_words() -> None:
    lines = format_title("Deformed mesh without rigid motion, amplified 20 times", 3.0, 11.0).splitlines()
    assert len(lines) == 2
    assert " ".join(lines) == "Deformed mesh without rigid motion, amplified 20 times"


def test_the_deformed_mesh_is_drawn_without_rigid_motion_and_never_folds(result: Result) -> None:
    mesh = result.mesh
    c, s = np.cos(0.3), np.sin(0.3)
    stretched = mesh.nodes * [1.01, 0.99]
    # One node runs a tenth of its cell: 5 % of the mesh, 2 px, would take it out of its cells.
    stretched[7] += [1.0, 0.6]
    moved = stretched @ np.array([[c, s], [-s, c]]) + [500.0, 40.0]
    turned = replace(result, displacement=moved - mesh.nodes)
    factor = find_shared_view([turned], None, PIXELS).factor
    assert 1.0 <= factor <= 0.5 / 0.1
    axes = draw_deformed(turned).axes[0]
    drawn = np.array([path.vertices[:-1] for path in axes.collections[-1].get_paths()], dtype=object)
    nodes = np.empty_like(mesh.nodes)
    for cell, corners in zip(mesh.cells, drawn, strict=True):
        nodes[cell[cell >= 0]] = corners[:np.count_nonzero(cell >= 0)]
    assert count_folded_cells(mesh, nodes) == 0
    # Neither the turn by 17 degrees nor the 500 px are in the picture.
    assert np.abs(nodes - mesh.nodes).max() < 6.0


def test_a_factor_that_folds_cells_is_drawn_and_said(result: Result) -> None:
    squeezed = replace(result, displacement=result.mesh.nodes * [-0.1, 0.0])
    assert "15 cells are folded" in draw_deformed(squeezed, "x", 11.0).axes[0].get_title()
    assert "folded" not in draw_deformed(squeezed, "x", 9.0).axes[0].get_title()
    assert find_shared_view([squeezed], None, PIXELS).factor <= 5.0


def test_physical_units_scale_axes_and_colours(result: Result) -> None:
    pixels, physical = draw_deformed(result, "x", 2.0), draw_deformed(result, "x", 2.0, MM)
    for one, other in zip(pixels.axes[0].get_xlim(), physical.axes[0].get_xlim(), strict=True):
        assert other == pytest.approx(MM.size * one)
    assert physical.axes[0].get_xlabel() == "x [mm]"
    np.testing.assert_allclose(physical.axes[0].collections[1].get_array(), MM.size * result.displacement[:, 0])
    assert "[mm]" in physical.axes[0].child_axes[0].get_ylabel()


def test_displacement_lies_over_the_image(result: Result) -> None:
    image = Preview(np.arange(3000.0).reshape(50, 60), 1, 60, 50)
    axes = draw_displacement(result, image, "y", scale=ColourScale((-0.1, 0.2))).axes[0]
    below, above = axes.images
    colours = axes.collections[0]
    assert below.get_zorder() < colours.get_zorder() < above.get_zorder()
    assert (below.get_alpha(), above.get_alpha()) == (1.0, pytest.approx(0.3))
    assert colours.get_clim() == (-0.1, 0.2)
    np.testing.assert_array_equal(colours.get_array(), result.displacement[:, 1])


def test_strain_maps_show_what_the_file_holds(result: Result) -> None:
    strained = shaped(result, "as it is")
    panels, tensors = draw_strain(strained, StrainChoice()).axes[:3], strained.point_data[NODAL_INFINITESIMAL]
    for axes, component in zip(panels, (0, 1, 3), strict=True):
        np.testing.assert_array_equal(axes.collections[0].get_array(), tensors[:, component])
        assert "[-]" in axes.child_axes[0].get_ylabel()
    by_cell = draw_strain(strained, StrainChoice(number="yy", by_cell=True)).axes[0].collections[0]
    np.testing.assert_array_equal(by_cell.get_array(), result.cell_data["strain_infinitesimal"][:, 1])
    first = draw_strain(strained, StrainChoice(number="principal-1")).axes[0].collections[0].get_array()
    # Of (x, -2 x, x / 2): -x / 2 + sqrt((3 / 2)^2 + (1 / 2)^2) x.
    np.testing.assert_allclose(first, (np.sqrt(2.5) - 0.5) * strained.mesh.nodes[:, 0] * 1e-5)


def test_signed_residual_keeps_its_sign_with_zero_in_the_middle(result: Result) -> None:
    picture = draw_residual(result, signed=True).axes[0].images[0]
    np.testing.assert_array_equal(picture.get_array().filled(np.nan), result.residual_image)
    low, high = picture.get_clim()
    assert low == -high
    assert high == pytest.approx(np.nanpercentile(np.abs(result.residual_image), 99.5), rel=1e-6)


def test_subdomains_have_numbers_and_other_colours_than_their_neighbours(result: Result) -> None:
    assert sorted(text.get_text() for text in draw_partition(result).axes[0].texts) == ["0", "1"]
    mesh = build_structured_mesh((0, 0, 160, 160), 10)
    ids = (mesh.centroids // 40).astype(np.int64) @ [1, 4]
    colours = choose_colours(mesh, ids).reshape(4, 4)
    # Corners touch as well.
    for a, b in ((colours[1:], colours[:-1]), (colours[:, 1:], colours[:, :-1]), (colours[1:, 1:], colours[:-1, :-1])):
        assert (a != b).all()
    # As the commonest colour blindness sees them (Machado, Oliveira, Fernandes, 2009): 0.2 of the cube's side is plain.
    deuteranopia = np.array([[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]])
    seen = PALETTE @ deuteranopia.T
    apart = np.linalg.norm(seen[:, None] - seen[None], axis=2) + np.eye(len(seen))
    assert apart.min() > 0.2


def test_iterations_are_whole_numbers_and_each_has_a_marker(result: Result) -> None:
    axes = draw_krylov({"": [np.array([1.0, 0.1]), np.array([0.5])]}).axes[0]
    ticks = [tick for tick in axes.get_xticks() if axes.get_xlim()[0] <= tick <= axes.get_xlim()[1]]
    assert ticks == [0.0, 1.0]
    assert all(line.get_marker() not in ("None", "", None) for line in axes.lines)
    assert [line.get_label() for line in axes.lines] == ["Gauss-Newton 1", "Gauss-Newton 2"]


def test_vector_files_and_dots(tmp_path: Path, write_result: Write) -> None:
    path = write_result(tmp_path / "r.vtkhdf")
    for ending, begin in (("pdf", b"%PDF"), ("svg", b"<?xml")):
        outcome = CliRunner().invoke(plot, [str(path), "--kind", "deformed", "--format", ending])
        assert outcome.exit_code == 0, outcome.output
        written = (tmp_path / f"r.deformed.{ending}").read_bytes()
        assert written.startswith(begin)
        # Fonts that journals take.
        assert ending != "pdf" or b"/Type3" not in written
    outcome = CliRunner().invoke(plot, [str(path), "--kind", "deformed", "--dpi", "300"])
    assert outcome.exit_code == 0, outcome.output
    assert cv2.imread(str(tmp_path / "r.deformed.png")).shape[1] == 2100


@pytest.mark.parametrize(("arguments", "message"), [
    (["--kind", "strain"], "--by-cell"),
    (["--kind", "deformed", "--limits", "1", "1"], "--limits 1 1"),
    (["--kind", "deformed", "--percentiles", "98", "2"], "--percentiles 98 2"),
    (["--kind", "deformed", "--cmap", "nonsense"], "no such colour map"),
    (["--kind", "sigma"], "output.uncertainty = true"),
    (["--kind", "krylov", "--limits", "0", "1"], "not --kind krylov"),
    (["--limits", "0", "1"], "not --kind all"),
    (["--kind", "deformed", "--units", "physical"], "images.pixel_size"),
])
def test_what_cannot_be_drawn_is_said_in_a_line(tmp_path: Path, write_result: Write, arguments: list[str],
                                                message: str) -> None:
    outcome = CliRunner().invoke(plot, [str(write_result(tmp_path / "r.vtkhdf")), *arguments])
    assert outcome.exit_code == 2
    assert message in outcome.stderr
    assert len(outcome.stderr.splitlines()) == 1
    assert not list(tmp_path.glob("*.png"))


def test_check_draws_the_mesh(tmp_path: Path) -> None:
    write_images(tmp_path)
    case = write_case(tmp_path, "[[discontinuity]]\nvertices = [[10, 60], [180, 90]]\n")
    outcome = CliRunner().invoke(check, [str(case), "--plot", str(tmp_path / "mesh.png")])
    assert outcome.exit_code == 0, outcome.output
    assert outcome.output.splitlines()[-1].split() == ["picture", str(tmp_path / "mesh.png")]
    assert cv2.imread(str(tmp_path / "mesh.png")).std() > 5
    for name, remedy in (("mesh.jpg", "must end in"), ("gone/mesh.png", "does not exist")):
        outcome = CliRunner().invoke(check, [str(case), "--plot", str(tmp_path / name)])
        assert outcome.exit_code == 2
        assert remedy in outcome.stderr


def test_the_preview_shows_cells_sets_and_lines(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "f.tif", np.zeros((100, 120), np.uint8))
    from ddic.plots.maps import read_preview

    mesh = build_structured_mesh((10, 10, 90, 90), 20)
    line = np.array([[0.0, 40.0], [100.0, 50.0]])
    axes = draw_mesh_preview(mesh, read_preview(open_image(tmp_path / "f.tif")), [line]).axes[0]
    assert len(axes.collections[0].get_paths()) == mesh.n_cells
    np.testing.assert_array_equal(axes.lines[-1].get_xydata(), line)
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [
        "left (5)", "right (5)", "top (5)", "bottom (5)", "line 1"]


def test_three_bad_nodes_do_not_change_the_colours_of_the_others(result: Result) -> None:
    mesh = build_structured_mesh((10, 10, 410, 410), 20)
    field = 0.001 * mesh.nodes
    spoilt = field.copy()
    spoilt[100:103] = 50.0
    good, bad = (replace(result, mesh=mesh, displacement=u) for u in (field, spoilt))
    first, second = (draw_displacement(one, component="x").axes[0] for one in (good, bad))
    span = np.ptp(first.collections[0].get_clim())
    # Three of 441 nodes are less than the 2 % beyond the colours.
    np.testing.assert_allclose(second.collections[0].get_clim(), first.collections[0].get_clim(), atol=0.05 * span)
    label = second.child_axes[0].get_ylabel()
    assert label.endswith("2 to 98 % of the values")
    whole = draw_displacement(bad, component="x", scale=ColourScale(percentiles=(0.0, 100.0))).axes[0]
    assert whole.collections[0].get_clim() == (pytest.approx(0.01), 50.0)
    assert "%" not in whole.child_axes[0].get_ylabel()


def test_the_colour_bar_has_the_colours_of_what_lies_under_the_image(result: Result) -> None:
    grey = Preview(np.array([[0.0, 200.0], [50.0, 150.0]]).repeat(30, 0).repeat(30, 1), 1, 60, 60)
    bar = draw_displacement(result, grey, "x").axes[0].child_axes[0]
    (mesh,) = [c for c in bar.collections if c.get_array() is not None]
    # 0.7 of a colour and 0.3 of the mean grey, half of what is white.
    expected = 0.7 * np.array(colormaps["viridis"](0.0)[:3]) + 0.3 * 0.5
    np.testing.assert_allclose(mesh.get_cmap()(0.0)[:3], expected, atol=1e-6)


def test_the_deformed_mesh_has_the_colours_of_what_moves_it(result: Result) -> None:
    moved = replace(result, displacement=result.mesh.nodes * [0.01, 0.0] + [500.0, 40.0])
    colours = draw_deformed(moved, "x").axes[0].collections[1].get_array()
    assert np.abs(colours).max() < 1.0
    assert draw_deformed(moved, "x", 1.0).axes[0].collections[1].get_array().min() > 499.0


def test_a_title_of_ones_own_stands_alone_and_an_empty_one_leaves_no_gap(result: Result) -> None:
    strained = shaped(result, "as it is")
    own, asked, without = (draw("strain", Drawing(strained, None, Look(title=title)))
                           for title in (None, "Specimen 7", ""))
    assert [axes.get_title() != "" for axes in own.axes] == [True] * 3
    for figure in (asked, without):
        assert [axes.get_title() for axes in figure.axes] == [""] * 3
        assert find_clipped_texts(figure) == []
    assert [text.get_text() for text in asked.texts] == ["Specimen 7"]
    assert asked.get_size_inches()[1] == pytest.approx(own.get_size_inches()[1])
    assert without.get_size_inches()[1] == pytest.approx(own.get_size_inches()[1] - 0.22)


@pytest.mark.parametrize(("asked", "length"), [(0.0, 5.0), (12.5, 12.5)])
def test_a_scale_bar_is_as_long_as_it_says(result: Result, asked: float, length: float) -> None:
    (axes,) = draw("displacement", Drawing(result, None, Look(scale_bar=asked))).axes
    (bar,) = axes.lines
    # The axes are 44.8 px wide, of which a fifth is 9.
    assert np.ptp(bar.get_xdata()) == pytest.approx(length)
    assert [text.get_text() for text in axes.texts] == [f"{length:g} px"]


def test_no_picture_takes_the_place_of_another(tmp_path: Path, write_result: Write) -> None:
    path = write_result(tmp_path / "r.vtkhdf")
    asked = (["--kind", "strain", "--by-cell", "--strain", "yy"], ["--kind", "strain", "--by-cell", "--strain", "xx"],
             ["--kind", "strain", "--by-cell", "--measure", "hencky"], ["--kind", "displacement"],
             ["--kind", "displacement", "--component", "x"], ["--kind", "line", "--line", "10", "10", "40", "20"])
    for arguments in asked:
        outcome = CliRunner().invoke(plot, [str(path), *arguments])
        assert outcome.exit_code == 0, outcome.output
    assert sorted(picture.name for picture in tmp_path.glob("*.png")) == [
        "r.displacement.png", "r.displacement_x.png", "r.line_10_10_40_20.png", "r.strain_hencky_by_cell.png",
        "r.strain_xx_by_cell.png", "r.strain_yy_by_cell.png"]


def test_a_result_draws_itself(result: Result) -> None:
    axes = result.plot("displacement", component="y", limits=(-1.0, 1.0), palette="cividis").axes[0]
    assert axes.collections[0].get_clim() == (-1.0, 1.0)
    assert axes.collections[0].get_cmap().name == "cividis"
    for kind, message in (("colour", "one of partition"), ("difference", "one of partition"),
                          ("sigma", "output.uncertainty"), ("near-far", "of one camera")):
        with pytest.raises(InputError, match=message):
            result.plot(kind)


def test_standard_deviations_and_bias_are_drawn(result: Result) -> None:
    n = result.mesh.n_nodes
    fields = {"sigma_u": np.linspace(0.0, 1.0, n), "sigma_v": np.linspace(1.0, 2.0, n),
              "sigma_exy": np.linspace(2.0, 3.0, n), "regularization_bias": np.full((n, 3), 3.0)}
    known = replace(result, point_data={**result.point_data, **fields})
    shown = [axes.collections[0].get_array() for axes in known.plot("sigma").axes]
    np.testing.assert_array_equal(shown, [fields["sigma_u"], fields["sigma_v"]])
    one = known.plot("sigma", number="xy").axes[0].collections[0].get_array()
    np.testing.assert_array_equal(one, fields["sigma_exy"])
    bias = known.plot("bias", component="magnitude").axes[0].collections[0].get_array()
    np.testing.assert_allclose(bias, np.hypot(3.0, 3.0))


def test_a_notebook_shows_a_small_map_with_the_verdict(result: Result) -> None:
    judged = replace(result, verdict=Verdict(LOOK, ("3 cells <here>",)))
    page = judged._repr_html_()
    assert "look before you trust this field: 3 cells &lt;here&gt;" in page
    assert page.count("data:image/png;base64,") == 1
    assert len(page) < 60_000
    assert repr(judged).endswith(f"look, 20 nodes, 15 cells, 2 subdomains, {len(judged.fields)} fields>")
    assert repr(judged.mesh).startswith("<ddic.Mesh: 20 nodes, 15 cells (")

"""Pictures of volumes: every kind on slices or as a curve, by the command line and in a report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from PIL import Image

from accept.report_page import find_clipped_texts, find_smallest_type
from ddic.cli.info import info, report
from ddic.cli.plot import plot
from ddic.cli.plot_figures import find_shared_scale
from ddic.errors import InputError
from ddic.images.binned import ArraySource
from ddic.io import result_schema as schema
from ddic.io.result_reader import Result, read_result
from ddic.io.series_reader import gather_history, read_series
from ddic.plots import curves
from ddic.plots import slices as of_volumes
from ddic.plots.canvas import OF_VALUES, PIXELS, LengthUnit, list_image_axes
from ddic.plots.figures import Drawing, Look, draw
from ddic.plots.kinds import COMPONENTS, KINDS, NUMBERS
from ddic.plots.maps import StrainChoice, list_sigma_panels, list_strain_panels, read_below
from ddic.plots.partition import draw_mesh_preview, draw_partition
from ddic.plots.series import draw_time_curves
from ddic.plots.slices import choose_slices
from ddic.report import items, page
from ddic.report.page import draw_report_figures
from support.series_files import FrameFile, write_series_file
from support.volume_results import (
    BOX,
    SIZES,
    build_volume_mesh,
    displace,
    make_residual,
    make_volume,
    strain,
    write_volume_result,
)

MM = LengthUnit(0.5, "mm")

@pytest.fixture(autouse=True)
def few_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures of some dots take a fraction of the time."""
    monkeypatch.setattr(of_volumes, "N_SAMPLES", 60)
    monkeypatch.setattr(page, "DPI", 30)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A result of volumes, beside its reference."""
    np.save(tmp_path / "f.npy", make_volume())
    return write_volume_result(tmp_path / "r.vtkhdf", build_volume_mesh(), residual=make_residual(),
                               reference=str(tmp_path / "f.npy"), length_unit="mm")


def run_plot(path: Path, *arguments: str) -> tuple[int, str]:
    ran = CliRunner().invoke(plot, [str(path), "--dpi", "30", *arguments])
    return ran.exit_code, ran.output


def test_components_are_those_of_their_names(path: Path) -> None:
    """The file has YZ before XZ: a swap would show nowhere else."""
    result = read_result(path)
    expected = strain(result.mesh.nodes)
    for number, place in zip(("xx", "yy", "zz", "xy", "yz", "xz"), range(6), strict=True):
        (panel,) = list_strain_panels(result, StrainChoice(number=number))
        np.testing.assert_array_equal(panel.values, expected[:, place])
        assert number in panel.label
        (deviation,) = list_sigma_panels(result, "magnitude", number, PIXELS)
        np.testing.assert_array_equal(deviation.values, 1e-5 * expected[:, place])
    with pytest.raises(InputError, match="noise of strain principal-3 is not estimated; give one of xx, yy, zz"):
        list_sigma_panels(result, "magnitude", "principal-3", PIXELS)
    panels = list_strain_panels(result, StrainChoice(by_cell=True))
    assert [panel.label.split("{")[1].split("}")[0] for panel in panels] == ["xx", "yy", "zz", "xy", "yz", "xz"]
    # Principal values of xx, yy, zz, xy, yz, xz by the tensor itself.
    tensors = expected[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, 3, 3)
    for k in range(3):
        (panel,) = list_strain_panels(result, StrainChoice(number=f"principal-{k + 1}"))
        np.testing.assert_allclose(panel.values, np.linalg.eigvalsh(tensors)[:, 2 - k], atol=1e-15)


def test_fields_are_drawn_on_slices_over_the_grey_levels(path: Path) -> None:
    result = read_result(path)
    volume = ArraySource(Path("f"), make_volume(), 255.0)
    slices = choose_slices(result.mesh, volume, [("z", 12.0), ("x", 45.0), ("y", 30.0)])
    figure = draw("displacement", Drawing(result, None, Look("z", unit=MM), slices))
    axes = list_image_axes(figure)
    assert len(axes) == 3
    for of_slice, one in zip(axes, slices, strict=True):
        field, grey = of_slice.images
        sampled = one.sample(0.5 * displace(result.mesh.nodes)[:, 2])
        np.testing.assert_array_equal(field.get_array().filled(np.nan), sampled)
        x0, y0, x1, y1 = (0.5 * value for value in one.box)
        assert field.get_extent() == [x0, x1, y1, y0]
        assert one.grey is not None
        np.testing.assert_array_equal(grey.get_array(), one.grey.pixels)
        # The middle of the first voxel lies at 0.
        assert grey.get_extent()[0] == -0.25
        assert field.zorder > grey.zorder
        # Colours are those of the whole field, not of the slice.
        low, high = OF_VALUES.find_limits(0.5 * displace(result.mesh.nodes)[:, 2])
        assert field.get_clim() == pytest.approx((low, high))


def test_a_residual_volume_is_read_where_it_is_looked_at(path: Path) -> None:
    result, residual = read_result(path), make_residual()
    slices = choose_slices(result.mesh, None, [("z", 12.0), ("x", 45.0), ("y", 30.0)])
    figure = draw("signed-residual", Drawing(result, None, Look(), slices))
    planes = residual[12], residual[:, :, 45].T, residual[:, 30]
    for axes, plane in zip(list_image_axes(figure), planes, strict=True):
        np.testing.assert_array_equal(axes.images[0].get_array().filled(np.nan), plane)
        assert axes.images[0].get_extent()[:2] == [-0.5, plane.shape[1] - 0.5]
    seen = np.concatenate([plane.ravel() for plane in planes])
    assert f"standard deviation {np.nanstd(seen):.3g} grey levels" in figure.axes[0].get_title()
    edge = np.nanpercentile(np.abs(seen), 99.5)
    assert list_image_axes(figure)[0].images[0].get_clim() == pytest.approx((-edge, edge))
    draw("histogram", Drawing(result, None, Look()))
    assert CliRunner().invoke(info, [str(path)]).exit_code == 0
    assert "residual_image" not in result.__dict__


def test_the_histogram_of_pieces_is_that_of_the_whole(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result, residual = read_result(path), make_residual()
    monkeypatch.setattr(curves, "CHUNK_SIDES", {3: 7})
    (axes,) = curves.draw_residual_histogram(result).axes
    values = residual[np.isfinite(residual)].astype(np.float64)
    edge = 6.0 * values.std()
    density, edges = np.histogram(values, 120, (-edge, edge), density=True)
    drawn = axes.patches[0].get_data()
    # Sums of other order; values beyond the edges count in the one and not in the other.
    np.testing.assert_allclose(drawn.edges, edges, rtol=1e-12)
    inside = (np.abs(values) <= edge).mean()
    np.testing.assert_allclose(drawn.values, density * inside, rtol=1e-9)


def test_a_frame_in_memory_has_its_residual_in_memory(path: Path) -> None:
    result = read_result(path)
    whole = result.residual_image
    assert whole is not None
    assert result.residual_extent is not None
    part = result.residual_extent.take_rows(5, 9)
    np.testing.assert_array_equal(result.read_residual(part), whole[5:9])
    with pytest.raises(ValueError, match="leaves the image"):
        result.read_residual(part.grow(10))


def test_every_kind_is_drawn_or_refused_in_a_line(path: Path, tmp_path: Path) -> None:
    code, output = run_plot(path, "--other", str(path), "--output", str(tmp_path / "all"))
    assert code == 0, output
    drawn = {name.name.split(".")[1] for name in (tmp_path / "all").iterdir()}
    assert drawn == {"partition", "strain", "sigma", "bias", "residual", "difference", "krylov"}
    for kind in set(KINDS) - drawn:
        line = ("--line", "8", "10", "50", "38", "--line-z", "12", "30") if kind == "line" else ()
        code, output = run_plot(path, "--kind", kind, *line, "--output", str(tmp_path / "all"))
        if kind in ("displacement", "signed-residual", "histogram", "line"):
            assert code == 0, output
        else:
            assert code == 2
            assert len(output.splitlines()) == 1, output


@pytest.mark.parametrize(("arguments", "said"), [
    (("--kind", "deformed"), "is of volumes, whose deformed mesh ParaView shows"),
    (("--kind", "independent"), "is of volumes, whose deformed mesh ParaView shows"),
    (("--kind", "line", "--line", "8", "10", "50", "38"), "needs --line-z Z1 Z2 too"),
    (("--kind", "displacement", "--line-z", "8", "10"), "--line X1 Y1 X2 Y2 goes with --kind line"),
    (("--kind", "strain", "--slice", "z=400"), "--slice z=400: the mesh lies between z = 10 and 34"),
    (("--kind", "strain", "--slice", "12"), "--slice 12: give x, y or z and its place in voxels"),
    (("--kind", "strain", "--slice", "z=inf"), "--slice z=inf: give x, y or z and its place in voxels"),
    (("--kind", "line", "--line", "0", "0", "1", "1", "--line-z", "0", "1"), "give x, y and z of its ends in voxels"),
])
def test_what_cannot_be_drawn_is_said_in_a_line(path: Path, arguments: tuple[str, ...], said: str) -> None:
    code, output = run_plot(path, *arguments)
    assert code == 2
    assert said in output
    assert len(output.splitlines()) == 1


def test_pictures_have_names_of_their_own(path: Path, tmp_path: Path) -> None:
    for arguments in (("--kind", "displacement", "--component", "z"),
                      ("--kind", "displacement", "--component", "z", "--slice", "z=12.5"),
                      ("--kind", "strain", "--strain", "xz", "--slice", "x=20", "--slice", "x=30"),
                      ("--kind", "histogram", "--slice", "z=12")):
        assert run_plot(path, *arguments, "--output", str(tmp_path / "new"))[0] == 0
    assert {name.name for name in (tmp_path / "new").iterdir()} == {
        "r.displacement_z.png", "r.displacement_z_z12.5.png", "r.strain_xz_x20_x30.png", "r.histogram.png"}


def stretched(result: Result, factors: tuple[float, float, float]) -> Result:
    """The result on a mesh of other proportions, whose residual volume is as large as that."""
    mesh = replace(result.mesh, nodes=result.mesh.nodes * factors)
    other = replace(result, mesh=mesh)
    sizes = (np.array(SIZES) * factors).astype(int)
    other.__dict__["residual_image"] = np.ones(sizes[::-1], np.float32)
    return other


@pytest.mark.parametrize("factors", [(4, 1, 0.3), (0.4, 5, 1), (0.5, 0.5, 8)], ids=["plate", "tall", "deep"])
def test_no_text_is_clipped(path: Path, factors: tuple[float, float, float]) -> None:
    result = stretched(read_result(path), factors)
    sets = {name: np.arange(30) for name in ("left", "a_name_of_a_set_that_nobody_would_type")}
    slices = choose_slices(result.mesh, None)
    drawing = Drawing(result, result, Look(unit=MM, scale_bar=0.0), slices)
    drawn = {kind: draw(kind, drawing) for kind in ("partition", "residual", "difference")}
    drawn["mesh"] = draw_mesh_preview(replace(result.mesh, node_sets=sets), slices)
    drawn["panels"] = draw("displacement", replace(drawing, preview=(slices[0], *slices)))
    for name, figure in drawn.items():
        assert find_clipped_texts(figure) == [], name


def test_no_text_of_six_components_is_clipped(path: Path) -> None:
    result = read_result(path)
    figure = draw("strain", Drawing(result, None, Look(), choose_slices(result.mesh, None)))
    assert len(list_image_axes(figure)) == 18
    assert find_clipped_texts(figure) == []


def test_subdomains_are_coloured_boxed_and_numbered(path: Path) -> None:
    result = read_result(path)
    slices = choose_slices(result.mesh, None, [("z", 14.0), ("x", 45.0), ("y", 37.0)])
    z, x, _ = list_image_axes(draw_partition(result, slices))
    assert [text.get_text() for text in z.texts] == ["0", "1"]
    # All cells beyond x = 30 are of the second one.
    assert [text.get_text() for text in x.texts] == ["1"]
    boxes = [patch.get_bbox().extents for patch in z.patches if isinstance(patch, Rectangle)]
    # To half the distance of points, 48 / 60.
    np.testing.assert_allclose(sorted(box[0] for box in boxes), [6.0, 30.0], atol=0.41)
    colours = z.images[0].get_array()
    assert len(np.unique(colours[slices[0].cells >= 0][:, :3], axis=0)) == 3


def test_node_sets_are_marked_on_the_cells_of_a_slice() -> None:
    mesh = build_volume_mesh()
    left = np.flatnonzero(mesh.nodes[:, 0] == BOX[0])
    slices = choose_slices(mesh, None, [("z", 14.0), ("x", 45.0)])
    z, x = list_image_axes(draw_mesh_preview(replace(mesh, node_sets={"left": left}), slices))
    marks = z.lines[-1].get_xydata()
    # y of its five rows, on both sides of the slice.
    np.testing.assert_array_equal(np.unique(marks[np.isfinite(marks[:, 0])], axis=0),
                                  [[6.0, y] for y in (8.0, 16.0, 24.0, 32.0, 40.0)])
    assert np.isnan(x.lines[-1].get_xydata()).all()
    assert x.get_legend() is not None


def test_a_plane_result_has_no_slices(tmp_path: Path) -> None:
    path = write_series_file(tmp_path / "s.vtkhdf", [FrameFile(1.0)], residual=True)
    assert run_plot(path, "--kind", "histogram", "--frame", "1")[0] == 0
    for arguments, named in ((("--component", "z"), "no z"), (("--strain", "yz"), "no yz"),
                             (("--strain", "principal-3"), "no principal-3"), (("--slice", "z=3"), "no slice z=3")):
        kind = "displacement" if arguments[0] != "--strain" else "strain"
        code, output = run_plot(path, "--kind", kind, "--frame", "1", *arguments)
        assert code == 2
        assert f"is of images and has {named}, which is of volumes" in output
    assert set(COMPONENTS) - {"z"} == {"x", "y", "magnitude"}
    assert len(NUMBERS) == 10


def test_the_report_says_voxels_and_marks_the_worst_places(path: Path, tmp_path: Path) -> None:
    result = read_result(path)
    places = items.find_worst_places(result)
    gathered = items.gather_all(result)
    drawn = draw_report_figures(gathered, places)
    names = [name for name, _, _ in drawn["fields"]]
    assert names == ["displacement x", "displacement y", "displacement z", "strain xx", "strain yy", "strain zz",
                     "strain von-mises"]
    for of_section in drawn.values():
        for name, _, figure in of_section:
            assert find_clipped_texts(figure) == [], name
            assert find_smallest_type(figure) >= 6.0, name
    views, others = (figure for _, _, figure in drawn["residual"])
    for axes in list_image_axes(views):
        assert "1" in numbers_on(axes.figure)
    assert {text for axes in list_image_axes(others) for text in (t.get_text() for t in axes.texts)} >= {"2", "3"}
    stated = {name: value for of_section in items.list_statements(gathered).values() for name, value in of_section}
    assert stated["Volume size"] == "60 x 50 x 45 px"
    assert stated["Method"] == "global DVC by finite elements"
    assert stated["Image scale"] == "0.5 mm per voxel (2 px per mm)"
    assert stated["Element size (subset size and step)"] == "8 to 8 px, mean 8 px (cube root of the volume)"
    assert "Scanner" in stated
    assert "Lens" not in stated
    ran = CliRunner().invoke(report, [str(path), "--output", str(tmp_path / "page.html")])
    assert ran.exit_code == 0, ran.output
    text = (tmp_path / "page.html").read_text()
    assert "Report on a digital volume correlation measurement" in text
    assert "<th>x, y, z [px]</th>" in text
    assert "residual_image" not in result.__dict__


def numbers_on(figure: Figure) -> set[str]:
    return {text.get_text() for axes in list_image_axes(figure) for text in axes.texts}


def test_info_lists_all_axes(path: Path) -> None:
    told = CliRunner().invoke(info, [str(path)]).output
    low, high = displace(build_volume_mesh().nodes).min(axis=0), displace(build_volume_mesh().nodes).max(axis=0)
    for axis, first, last in zip("xyz", low, high, strict=True):
        assert f"displacement {axis}              {first:.4f} to {last:.4f} px" in told
    assert "residual                    standard deviation 2.5 grey levels" in told


@pytest.fixture
def series(tmp_path: Path) -> Path:
    """Three frames of volumes, of which the second was not measured."""
    mesh = build_volume_mesh(box=(8.0, 8.0, 4.0, 56.0, 36.0, 16.0), size=4.0)
    frames = [FrameFile(1.0, mesh=mesh), FrameFile(2.0, 0, mesh), FrameFile(4.0, mesh=mesh)]
    return write_series_file(tmp_path / "s.vtkhdf", frames, residual=True)


def test_curves_over_time_have_all_axes(series: Path, tmp_path: Path) -> None:
    history = gather_history(read_series(series))
    figure = draw_time_curves(history, "s", PIXELS)
    assert find_clipped_texts(figure) == []
    above, below = figure.axes[:2]
    named = {line.get_label(): line.get_ydata() for line in (*above.lines, *below.lines)}
    for axis in "xyz":
        assert np.isfinite(named[f"$u_{axis}$, mean"]).tolist() == [True, False, True]
    # Along x, z and y: 0.01, 0.0025 and -0.005 a unit of time.
    for k, strain_of_time in enumerate((0.01, 0.0025, -0.005), start=1):
        np.testing.assert_allclose(named[rf"$\varepsilon_{k}$, mean"][[0, 2]], np.array([1.0, 4.0]) * strain_of_time)
    told = CliRunner().invoke(info, [str(series)]).output
    assert "displacement z              0.0100 to 0.1600 px in all frames" in told


def test_frames_of_volumes_are_animated_in_the_same_colours(series: Path, tmp_path: Path) -> None:
    opened = read_series(series)
    slices = choose_slices(opened[0].mesh, None, [("z", 6.0)])
    (scale,) = find_shared_scale(opened, "residual", Look(), slices).scales
    # A frame's residual is its number everywhere.
    assert scale.limits == (0.0, 3.0)
    code, output = run_plot(series, "--animate", "--kind", "displacement", "--component", "z", "--slice", "z=6",
                            "--output", str(tmp_path / "new"))
    assert code == 0, output
    with Image.open(tmp_path / "new" / "s.displacement_z_z6.gif") as animation:
        assert animation.n_frames == 2


def test_a_thumbnail_is_drawn_of_volumes(path: Path) -> None:
    assert "data:image/png" in read_result(path)._repr_html_()
    assert len(list_image_axes(read_result(path).plot("strain", number="xz"))) == 3
    below = read_below(read_result(path).mesh, None, [("z", 20.0)])
    assert isinstance(below, tuple)
    assert schema.NODAL_HENCKY in read_result(path).point_data

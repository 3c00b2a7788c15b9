"""Measuring from Python, in all the ways in which images, meshes and settings can be given."""

from __future__ import annotations

import copy
import pickle
import tomllib
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import pytest
import tifffile
from mpi4py import MPI
from numpy.typing import NDArray

import ddic
from ddic.errors import InputError
from ddic.kinematics.kinematics import RegionKinematics
from support.small_pair import REGULARIZED, WITHIN, largest_error, move

Pair = tuple[NDArray[np.uint8], NDArray[np.uint8]]
HIDDEN = (slice(50, 70), slice(60, 75))
"""Rows and columns of the pixels that masks leave out."""
BESIDE_A_MASK = 2 * WITHIN
"""What lies under a mask reaches two pixels out of it, through the spline; where it is nan, nothing does."""


@pytest.fixture(scope="module")
def measured(pair: Pair, mesh: ddic.Mesh) -> ddic.Result:
    return ddic.measure(pair, mesh)


@pytest.fixture
def used() -> NDArray[np.bool_]:
    mask = np.ones((140, 160), dtype=bool)
    mask[HIDDEN] = False
    return mask


def test_arrays(measured: ddic.Result) -> None:
    assert largest_error(measured) < WITHIN


@pytest.mark.parametrize("dtype", ["uint8", "uint16", ">u2", "int16", "uint32", "int64", "float16", "float32",
                                   "float64", ">f4", ">f8"])
def test_every_type_of_grey_level_gives_the_same_field(pair: Pair, mesh: ddic.Mesh, measured: ddic.Result,
                                                       dtype: str) -> None:
    reference, deformed = (image.astype(dtype) for image in pair)
    assert np.array_equal(ddic.measure((reference, deformed), mesh).displacement, measured.displacement)


@pytest.mark.parametrize("change", [
    np.asfortranarray, lambda image: np.repeat(image, 2, axis=1)[:, ::2], lambda image: image.tolist(),
    ddic.Image], ids=["columns", "strides", "lists", "Image"])
def test_every_layout_gives_the_same_field(pair: Pair, mesh: ddic.Mesh, measured: ddic.Result, change: Any) -> None:
    result = ddic.measure([change(image) for image in pair], mesh)
    assert np.array_equal(result.displacement, measured.displacement)


def test_stack_of_two_images(pair: Pair, mesh: ddic.Mesh, measured: ddic.Result) -> None:
    assert np.array_equal(ddic.measure(np.stack(pair), mesh).displacement, measured.displacement)


def test_images_of_the_user_stay_as_they_are(pair: Pair, mesh: ddic.Mesh) -> None:
    reference, deformed = (image.copy() for image in pair)
    ddic.measure((reference, deformed), mesh)
    assert np.array_equal(reference, pair[0])
    reference[0, 0] = 0
    deformed[0, 0] = 0


@pytest.mark.parametrize("wrap", [np.asarray, ddic.Image, lambda image: np.ma.masked_array(image, mask=False)],
                         ids=["array", "Image", "masked array"])
def test_what_is_written_into_an_image_after_prepare_changes_nothing(pair: Pair, mesh: ddic.Mesh,
                                                                     measured: ddic.Result, wrap: Any) -> None:
    reference = pair[0].copy()
    with ddic.prepare(wrap(reference), mesh) as session:
        reference[:] = reference[::-1]
        assert np.array_equal(session.measure(pair[1]).displacement, measured.displacement)


def test_a_mesh_that_waits_for_its_line_is_kept_as_it_was(pair: Pair, mesh: ddic.Mesh) -> None:
    given, options = copy.deepcopy(mesh), {"discontinuity": "detect"}
    with ddic.prepare(pair[0], given, **options) as session:
        given.nodes[:] += 3
        result = session.measure(pair[1])
    assert np.array_equal(result.mesh.nodes, mesh.nodes)


def test_files(files: tuple[Path, Path], mesh: ddic.Mesh, measured: ddic.Result) -> None:
    for given in (files, tuple(map(str, files)), (ddic.Image(files[0]), files[1])):
        assert np.array_equal(ddic.measure(given, mesh).displacement, measured.displacement)


# ------------------------------------------------------------------------------------------------------------ masks


def test_masks_leave_pixels_out(pair: Pair, mesh: ddic.Mesh, used: NDArray[np.bool_], tmp_path: Path) -> None:
    spoiled = [image.copy() for image in pair]
    for image in spoiled:
        image[HIDDEN] = 255
    assert largest_error(ddic.measure(spoiled, mesh, **REGULARIZED)) > 4 * WITHIN
    tifffile.imwrite(tmp_path / "mask.tif", used.astype(np.uint8))
    fields = []
    path = tmp_path / "mask.tif"
    for mask in (used, used.astype(np.uint8) * 7, used.astype(float), path, str(path)):
        result = ddic.measure([ddic.Image(image, mask) for image in spoiled], mesh, **REGULARIZED)
        fields.append(result.displacement)
        assert largest_error(result) < BESIDE_A_MASK
    assert all(np.array_equal(field, fields[0]) for field in fields)


def test_keys_of_images_are_those_of_a_case(pair: Pair, mesh: ddic.Mesh, used: NDArray[np.bool_],
                                            tmp_path: Path) -> None:
    spoiled = [image.copy() for image in pair]
    for image in spoiled:
        image[HIDDEN] = 255
    path = tmp_path / "mask.tif"
    tifffile.imwrite(path, used.astype(np.uint8))
    by_image = ddic.measure([ddic.Image(image, used) for image in spoiled], mesh, **REGULARIZED)
    masks = {"reference_mask": path, "deformed_mask": path}
    by_keys = ddic.measure(images={"reference": spoiled[0], "deformed": spoiled[1], **masks}, mesh=mesh, **REGULARIZED)
    assert np.array_equal(by_keys.displacement, by_image.displacement)
    with ddic.prepare(images={"reference": spoiled[0], **masks}, mesh=mesh, **REGULARIZED) as session:
        of_session = session.measure(spoiled[1])
    assert np.abs(of_session.displacement - by_image.displacement).max() < 1e-4
    saturated = ddic.measure(spoiled, mesh, images={"exclude_saturated": True}, **REGULARIZED)
    assert largest_error(saturated) < BESIDE_A_MASK


def test_nan_under_a_mask_and_in_a_masked_array(pair: Pair, mesh: ddic.Mesh, used: NDArray[np.bool_]) -> None:
    spoiled = [np.where(used, image, np.nan) for image in pair]
    by_mask = ddic.measure([ddic.Image(image, used) for image in spoiled], mesh, **REGULARIZED)
    by_array = ddic.measure([np.ma.masked_invalid(image) for image in spoiled], mesh, **REGULARIZED)
    assert largest_error(by_mask) < WITHIN
    assert np.array_equal(by_mask.displacement, by_array.displacement)


def test_a_mask_wider_than_elements_needs_no_regularization(pair: Pair, mesh: ddic.Mesh, case_file: Path) -> None:
    used = np.ones(pair[0].shape, dtype=bool)
    used[35:105, 55:125] = False
    tifffile.imwrite(case_file.with_name("mask.tif"), used.astype(np.uint8))
    text = case_file.read_text(encoding="utf-8").replace("[mesh", 'reference_mask = "mask.tif"\n[mesh', 1)
    case_file.write_text(text.replace("[solver]\nsubdomains = 4\n", ""), encoding="utf-8")
    with ddic.prepare(ddic.Image(pair[0], used), mesh) as session:
        results = [session.measure(pair[1]), session.measure(pair[1])]
    results += [ddic.measure(case_file), ddic.measure((np.ma.masked_array(pair[0], mask=~used), pair[1]), mesh)]
    # 3 x 3 cells of 20 px lie under the mask whole; 2 x 2 nodes have no others.
    for result in results:
        assert np.isnan(result.displacement).any(axis=1).sum() == 4
        assert np.nanmax(np.abs(result.displacement - move(result.mesh.nodes))) < 2 * WITHIN
        assert np.allclose(result.displacement, results[0].displacement, rtol=0, atol=1e-9, equal_nan=True)


def test_saturated_pixels_of_the_reference_image_count_in_no_image(pair: Pair, mesh: ddic.Mesh) -> None:
    spoiled = [image.copy() for image in pair]
    for image in spoiled:
        image[HIDDEN] = 255
    result = ddic.measure((ddic.Image(spoiled[0], exclude_saturated=True), spoiled[1]), mesh, **REGULARIZED)
    assert largest_error(result) < BESIDE_A_MASK


@pytest.mark.parametrize("saturation", [None, 4000])
def test_saturation_of_12_bits_in_16_is_found_or_given(pair: Pair, mesh: ddic.Mesh, saturation: float | None) -> None:
    spoiled = [image.astype(np.uint16) * 12 for image in pair]
    for image in spoiled:
        assert image.max() < 4000
        image[HIDDEN] = 4095
    images = [ddic.Image(image, exclude_saturated=True, saturation=saturation) for image in spoiled]
    assert largest_error(ddic.measure(images, mesh, **REGULARIZED)) < BESIDE_A_MASK


def test_level_of_saturation_without_its_use_is_refused(pair: Pair, mesh: ddic.Mesh) -> None:
    with pytest.raises(InputError, match="saturation = 200 goes with exclude_saturated=True"):
        ddic.measure((ddic.Image(pair[0], saturation=200), pair[1]), mesh)


# ----------------------------------------------------------------------------------------------------------- meshes


def test_meshes_of_all_kinds(pair: Pair, mesh: ddic.Mesh, measured: ddic.Result) -> None:
    quads, nodes = mesh.cells, mesh.nodes
    for given in ((nodes, quads), (nodes.tolist(), quads.tolist()), (nodes, quads.astype(np.uint32)),
                  meshio.Mesh(nodes, [("quad", quads)]), measured.to_meshio()):
        result = ddic.measure(pair, given)
        assert np.array_equal(result.displacement, measured.displacement)


def test_clockwise_cells_are_turned(pair: Pair, mesh: ddic.Mesh, measured: ddic.Result) -> None:
    result = ddic.measure(pair, (mesh.nodes, mesh.cells[:, ::-1]))
    assert np.abs(result.displacement - measured.displacement).max() < 1e-12


def test_mixed_mesh_and_node_sets_of_meshio(pair: Pair, mesh: ddic.Mesh) -> None:
    quads = mesh.cells
    mixed = meshio.Mesh(mesh.nodes, [("quad", quads[1:]), ("triangle", quads[:1, [0, 1, 2]]),
                                     ("triangle", quads[:1, [0, 2, 3]])],
                        point_sets={"ends": np.flatnonzero(np.isin(mesh.nodes[:, 0], [20, 140]))})
    result = ddic.measure(pair, mixed, regularization={"cut_off_wavelength": 80,
                                                                   "not_controlled": ["ends"]})
    assert result.mesh.n_cells == len(quads) + 1
    assert largest_error(result) < WITHIN


@pytest.mark.parametrize("kind", ["arrays", "meshio", "ddic"])
def test_mesh_in_millimetres(pair: Pair, mesh: ddic.Mesh, measured: ddic.Result, kind: str) -> None:
    millimetres = (mesh.nodes - [20, 20]) / 10
    given: Any = (millimetres, mesh.cells)
    if kind == "meshio":
        given = meshio.Mesh(millimetres, [("quad", mesh.cells)])
    elif kind == "ddic":
        given = ddic.structured_mesh((0, 0, 12, 10), 2)
    result = ddic.measure(pair, mesh={"file": given, "mapping": {"scale": 10, "translation": [20, 20]}})
    assert np.abs(result.displacement - measured.displacement).max() < 1e-9
    assert result.fields["displacement_mesh_units"] == pytest.approx(result.displacement / 10, abs=1e-12)


@pytest.mark.parametrize("flip_y", [False, True])
def test_drawing_turned_and_with_y_up(pair: Pair, mesh: ddic.Mesh, tmp_path: Path, flip_y: bool) -> None:
    """A drawing of 10 px a millimetre, y up, turned by 30 degrees: x_px = 10 R S x_mm + (20, 20)."""
    mapping = {"scale": 10, "rotation_degrees": 30, "translation": [20, 20], "y_up": True}
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    axes = np.array([[c, s], [s, -c]])
    # Not on pixel centres, where rounding would decide which cell has a pixel.
    nodes = mesh.nodes + 0.25
    drawn = (nodes - [20, 20]) @ axes / 10
    path = tmp_path / "result.vtkhdf"
    result = ddic.measure(pair, mesh={"file": (drawn, mesh.cells), "mapping": mapping},
                          output={"file": path, "flip_y": flip_y})
    in_pixels = ddic.measure(pair, (nodes, mesh.cells))
    assert np.abs(result.displacement - in_pixels.displacement).max() < 1e-9
    in_drawing = result.displacement @ axes / 10
    assert result.fields["displacement_mesh_units"] == pytest.approx(in_drawing, abs=1e-12)
    # One subdomain: nodes in the file are in the order of the mesh. The drawing's axes do not turn with the image's.
    with h5py.File(path) as file:
        fields = file["VTKHDF/PointData"]
        assert fields["displacement_mesh_units"][:, :2] == pytest.approx(in_drawing, abs=1e-12)
        flipped = result.displacement * [1, -1 if flip_y else 1]
        assert np.array_equal(fields["displacement"][:, :2], flipped)


# --------------------------------------------------------------------------------------------- settings, kinematics


@pytest.mark.parametrize("method", ["dual", "assembled", "conjugate_gradient", "monolithic"])
def test_options_choose_the_method(pair: Pair, mesh: ddic.Mesh, measured: ddic.Result, method: str) -> None:
    solver: dict[str, Any] = {"method": method} if method == "monolithic" else {"method": method, "subdomains": 4}
    result = ddic.measure(pair, mesh, solver=solver)
    assert result.n_subdomains == solver.get("subdomains", 1)
    assert np.abs(result.displacement - measured.displacement).max() < 1e-3


def test_numbers_of_numpy_in_options(pair: Pair, mesh: ddic.Mesh) -> None:
    settings = {"solver": {"subdomains": np.int64(4)},
                "regularization": {"cut_off_wavelength": np.float32(80), "boxes": np.array([[0, 0, 30, 30]]),
                                   "not_controlled": ("boundary",)}}
    assert ddic.measure(pair, mesh, **settings).n_subdomains == 4


def test_residual_image_can_be_left_out(pair: Pair, mesh: ddic.Mesh) -> None:
    assert ddic.measure(pair, mesh, output={"residual_image": False}).residual_image is None


def test_lengths_in_millimetres(pair: Pair, mesh: ddic.Mesh) -> None:
    result = ddic.measure(pair, mesh, images={"pixel_size": 0.05, "length_unit": "mm"})
    assert result.attributes["units"]["length_unit"] == "mm"
    assert result.fields["displacement_physical"] == pytest.approx(0.05 * result.displacement, abs=1e-12)


def shift_whole(mesh: ddic.Mesh) -> ddic.LinearRegion:
    return ddic.LinearRegion(mesh, np.tile(np.eye(2), (mesh.n_nodes, 1)))


def test_own_kinematics(pair: Pair, mesh: ddic.Mesh) -> None:
    result = ddic.measure(pair, mesh, kinematics=shift_whole)
    assert np.ptp(result.displacement, axis=0) == pytest.approx([0, 0], abs=1e-12)
    assert result.displacement[0] == pytest.approx(move(np.array([[80.0, 70.0]]))[0], abs=0.02)


def test_own_kinematics_sees_the_repaired_mesh(pair: Pair, mesh: ddic.Mesh) -> None:
    seen = []

    def kinematics(given: ddic.Mesh) -> RegionKinematics:
        seen.append(given)
        return ddic.NodalRegion(given)

    unused = np.vstack([[[0.0, 0.0]], mesh.nodes])
    result = ddic.measure(pair, (unused, mesh.cells + 1), kinematics=kinematics)
    assert seen[0].n_nodes == result.mesh.n_nodes == mesh.n_nodes


def test_ranks_can_measure_alone(pair: Pair, mesh: ddic.Mesh) -> None:
    result = ddic.measure(pair, mesh, comm=MPI.COMM_SELF)
    assert largest_error(result) < WITHIN


# --------------------------------------------------------------------------------------------------------- results


@pytest.mark.parametrize("flip_y", [False, True])
def test_file_holds_what_was_returned(pair: Pair, mesh: ddic.Mesh, tmp_path: Path, flip_y: bool) -> None:
    path = tmp_path / "result.vtkhdf"
    returned = ddic.measure(pair, mesh, solver={"subdomains": 4}, output={"file": path, "flip_y": flip_y},
                            **REGULARIZED)
    read = ddic.open(path)
    assert np.array_equal(read.displacement, returned.displacement)
    assert np.array_equal(read.mesh.nodes, returned.mesh.nodes)
    assert np.array_equal(read.mesh.cells, returned.mesh.cells)
    assert list(read.fields) == list(returned.fields)
    for name, values in returned.fields.items():
        assert np.array_equal(read.fields[name], values), name
    assert list(read.gauss_newton) == list(returned.gauss_newton)
    for name, values in returned.gauss_newton.items():
        assert np.array_equal(read.gauss_newton[name], values, equal_nan=True), name
    assert len(read.krylov) == len(returned.krylov)
    assert read.residual_image is not None
    assert np.array_equal(read.residual_image, returned.residual_image, equal_nan=True)
    assert read.attributes["case"] == returned.attributes["case"]
    points = np.array([[33.3, 44.4], [139.0, 119.0]])
    assert np.array_equal(read.at(points), returned.at(points))


def test_fields_have_a_row_for_each_node_or_cell(measured: ddic.Result) -> None:
    mesh = measured.mesh
    assert measured.fields["displacement"].shape == (mesh.n_nodes, 2)
    assert np.array_equal(measured.fields["displacement"], measured.displacement)
    assert measured.fields["strain_infinitesimal"].shape == (mesh.n_cells, 6)
    assert measured.fields["residual_rms"].shape == (mesh.n_cells,)
    strain = measured.fields["strain_infinitesimal"].mean(axis=0)
    assert strain[[0, 1]] == pytest.approx([0.004, -0.002], abs=3e-4)


def test_at_points(measured: ddic.Result) -> None:
    nodes = measured.mesh.nodes
    assert measured.at(nodes) == pytest.approx(measured.displacement, abs=1e-12)
    middle = measured.mesh.centroids
    corners = measured.displacement[measured.mesh.cells].mean(axis=1)
    assert measured.at(middle) == pytest.approx(corners, abs=1e-12)
    assert np.isnan(measured.at([[5, 5], [np.nan, 50]])).all()
    assert measured.at(np.zeros((0, 2))).shape == (0, 2)


def test_to_meshio_and_pyvista(measured: ddic.Result, tmp_path: Path) -> None:
    exported = measured.to_meshio()
    exported.write(tmp_path / "field.vtu")
    read = meshio.read(tmp_path / "field.vtu")
    assert np.array_equal(read.point_data["displacement"][:, :2], measured.displacement)
    pyvista = pytest.importorskip("pyvista")
    grid = measured.to_pyvista()
    assert isinstance(grid, pyvista.UnstructuredGrid)
    assert grid.n_cells == measured.mesh.n_cells
    assert np.array_equal(grid["displacement"][:, :2], measured.displacement)


def test_results_can_be_pickled_and_copied(measured: ddic.Result) -> None:
    for other in (pickle.loads(pickle.dumps(measured)), copy.deepcopy(measured)):
        assert np.array_equal(other.displacement, measured.displacement)
        assert np.array_equal(other.residual_image, measured.residual_image, equal_nan=True)
        assert other.at(np.array([[50.0, 50.0]])) == pytest.approx(measured.at(np.array([[50.0, 50.0]])))


def test_results_and_meshes_can_be_compared_and_kept_in_sets(measured: ddic.Result, mesh: ddic.Mesh) -> None:
    assert measured == measured  # noqa: PLR0124  # arrays would make this an error
    assert len({measured, mesh, measured.mesh}) == 3


# ----------------------------------------------------------------------------------------------- cases and sessions


def test_case_file_case_and_loaded_case(case_file: Path, measured: ddic.Result) -> None:
    loaded = ddic.load_case(str(case_file))
    for source in (case_file, str(case_file), loaded, loaded.case):
        # The case names a folder that is not there, but nothing is written to it.
        result = ddic.measure(source)
        assert result.n_subdomains == 4
        assert np.abs(result.displacement - measured.displacement).max() < 1e-3


def test_case_writes_where_it_is_told(case_file: Path, tmp_path: Path) -> None:
    returned = ddic.measure(case_file, output=tmp_path / "r.vtkhdf")
    assert np.array_equal(ddic.open(str(tmp_path / "r.vtkhdf")).displacement, returned.displacement)


def test_case_with_own_kinematics(case_file: Path) -> None:
    result = ddic.measure(case_file, kinematics=shift_whole)
    assert np.ptp(result.displacement, axis=0) == pytest.approx([0, 0], abs=1e-12)


def test_session_measures_frames_with_one_factor(pair: Pair, mesh: ddic.Mesh, tmp_path: Path) -> None:
    reference, deformed = pair
    with ddic.prepare(reference, mesh, solver={"subdomains": 4}) as session:
        first = session.measure(deformed)
        still = session.measure(reference, output=tmp_path / "still.vtkhdf")
        again = session.measure(deformed, from_last=True)
        assert (session.n_assembled, session.n_factorized) == (4, 4)
    assert largest_error(first) < WITHIN
    assert np.abs(still.displacement).max() < 1e-4
    assert np.abs(again.displacement - first.displacement).max() < 1e-3
    assert np.array_equal(ddic.open(tmp_path / "still.vtkhdf").displacement, still.displacement)


def test_a_parsed_case_file_is_the_arguments(case_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(case_file.parent)
    sections = tomllib.loads(case_file.read_text(encoding="utf-8")) | {"output": {"file": "r.vtkhdf", "flip_y": True}}
    by_arguments = ddic.measure(**sections)
    assert np.abs(by_arguments.displacement - ddic.measure(case_file).displacement).max() < 1e-9
    assert by_arguments.n_subdomains == 4
    assert ddic.open("r.vtkhdf").flipped
    in_memory = {"reference": tifffile.imread("reference.tif"), "deformed": tifffile.imread("deformed.tif")}
    again = ddic.measure(**sections | {"images": in_memory, "output": None})
    assert np.array_equal(again.displacement, by_arguments.displacement)


def test_a_mesh_file_may_be_named(pair: Pair, mesh: ddic.Mesh, tmp_path: Path) -> None:
    meshio.Mesh(mesh.nodes / 10, [("quad", mesh.cells)]).write(tmp_path / "mesh.vtu")
    in_pixels = ddic.measure(pair, mesh={"file": tmp_path / "mesh.vtu", "mapping": {"scale": 10}})
    assert np.abs(in_pixels.displacement - ddic.measure(pair, mesh).displacement).max() < 1e-9
    meshio.Mesh(mesh.nodes, [("quad", mesh.cells)]).write(tmp_path / "pixels.vtu")
    by_name = ddic.measure(pair, tmp_path / "pixels.vtu")
    assert np.array_equal(by_name.displacement, ddic.measure(pair, mesh).displacement)


def test_masks_of_a_case_count_in_its_session(case_file: Path, pair: Pair, used: NDArray[np.bool_]) -> None:
    tifffile.imwrite(case_file.with_name("mask.tif"), used.astype(np.uint8))
    text = case_file.read_text(encoding="utf-8").replace("[mesh", 'deformed_mask = "mask.tif"\n[mesh', 1)
    case_file.write_text(text, encoding="utf-8")
    spoiled = pair[1].copy()
    spoiled[HIDDEN] = 255
    tifffile.imwrite(case_file.with_name("deformed.tif"), spoiled)
    with ddic.prepare(case_file) as session:
        found = session.measure(spoiled)
    assert np.abs(found.displacement - ddic.measure(case_file).displacement).max() < 1e-3


def test_session_of_a_case(case_file: Path, pair: Pair, measured: ddic.Result) -> None:
    with ddic.prepare(case_file) as session:
        assert np.abs(session.measure(pair[0]).displacement).max() < 1e-4
        result = session.measure(case_file.with_name("deformed.tif"))
    assert np.abs(result.displacement - measured.displacement).max() < 1e-3


def test_session_goes_on_after_a_frame_that_fails(pair: Pair, mesh: ddic.Mesh) -> None:
    reference, deformed = pair
    with ddic.prepare(reference, mesh) as session:
        good = session.measure(deformed)
        with pytest.raises(ddic.InputError):
            session.measure(deformed[:100])
        with pytest.raises(ddic.ConvergenceError):
            session.measure(np.ascontiguousarray(deformed[:, ::-1]))
        with pytest.raises(ddic.ConvergenceError, match="no pixel is left"):
            session.measure(ddic.Image(deformed, np.zeros(deformed.shape)))
        assert np.abs(session.measure(deformed).displacement - good.displacement).max() < 1e-6
        assert np.abs(session.measure(deformed, from_last=True).displacement - good.displacement).max() < 1e-3


def test_failed_measurement_brings_its_last_field(pair: Pair, mesh: ddic.Mesh, tmp_path: Path) -> None:
    reference, deformed = pair
    output = tmp_path / "frame.vtkhdf"
    with ddic.prepare(reference, mesh) as session:
        session.measure(deformed, output=tmp_path / "first.vtkhdf")
        session.measure(deformed, output=output)
        with pytest.raises(ddic.ConvergenceError, match=r"is in .*frame\.not_converged\.vtkhdf") as caught:
            session.measure(np.ascontiguousarray(deformed[:, ::-1]), output=output)
        result = caught.value.result
        assert not result.converged
        assert str(caught.value).startswith(result.failure)
        # Where the frame shows nothing of the specimen, nodes have no value.
        assert np.isfinite(result.displacement).any()
        assert result.residual_image.shape == reference.shape
        # Frames before it are as they were.
        assert sorted(p.name for p in tmp_path.glob("*.vtkhdf") if "residual" not in p.name) == [
            "first.vtkhdf", "frame.earlier.vtkhdf", "frame.not_converged.vtkhdf"]
        with pytest.warns(UserWarning, match="did not converge"):
            kept = ddic.open(tmp_path / "frame.not_converged.vtkhdf")
        assert np.array_equal(kept.displacement, result.displacement, equal_nan=True)
        assert largest_error(ddic.open(tmp_path / "first.vtkhdf")) < WITHIN
        session.measure(deformed, output=output)
    assert output.is_file()
    assert not list(tmp_path.glob("frame.not_converged*"))


def test_failed_measurement_in_memory_writes_nothing(pair: Pair, mesh: ddic.Mesh, tmp_path: Path,
                                                     monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ddic.ConvergenceError) as caught:
        ddic.measure((pair[0], np.ascontiguousarray(pair[1][:, ::-1])), mesh)
    assert not caught.value.result.converged
    # Errors that are sent on, by a pool of workers, say, bring their field along.
    assert np.array_equal(pickle.loads(pickle.dumps(caught.value)).result.displacement,
                          caught.value.result.displacement, equal_nan=True)
    assert list(tmp_path.iterdir()) == []


def test_synthetic_pair_takes_functions_and_fields(pair: Pair) -> None:
    from ddic.synth.fields import Affine

    field = Affine(((0.004, 0.0), (0.0, -0.002)), (0.4, -0.3), (80.0, 70.0))
    exact = ddic.make_synthetic_pair(field, (160, 140), noise=1, seed=1)
    assert all(np.array_equal(a, b) for a, b in zip(exact, pair, strict=True))
    assert pair[0].shape == (140, 160)
    dark, _ = ddic.make_synthetic_pair(np.zeros_like, (60, 50), hole={"center": (30, 25), "radius": 10})
    assert dark[25, 30] < 20


def test_progress_prints_what_a_run_prints(pair: Pair, mesh: ddic.Mesh, capsys: pytest.CaptureFixture[str]) -> None:
    ddic.measure(pair, mesh)
    assert capsys.readouterr().out == ""
    result = ddic.measure(pair, mesh, progress=True)
    lines = capsys.readouterr().out.splitlines()
    begin = next(number for number, line in enumerate(lines) if line.startswith("iter"))
    rows = [line for line in lines[begin + 1:] if line.split() and line.split()[0].isdigit()]
    assert len(rows) == len(result.gauss_newton["iteration"])

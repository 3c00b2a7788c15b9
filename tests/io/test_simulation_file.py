"""Displacements that simulations have computed, from every format, and the step that is asked for."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest
from scipy.io import netcdf_file

from ddic.errors import InputError
from ddic.io.simulations.simulation_file import list_steps, read_simulation, split_quadratic_cells
from ddic.mesh.interpolation import interpolate
from ddic.mesh.mesh import Similarity
from ddic.mesh.structured import build_structured_mesh

SAMPLES = Path(__file__).parent / "simulations"
MAPPING = Similarity(scale=20.0, angle=0.3, translation=(100.0, 50.0), y_up=True)
TIMES = (0.5, 1.0, 2.5)
MESH = build_structured_mesh((0.0, 0.0, 4.0, 3.0), 1.0)
POINTS = np.column_stack([MESH.nodes, np.zeros(MESH.n_nodes)])
CELLS = [("quad", MESH.cells)]


def _field(place: int, points: np.ndarray = POINTS) -> np.ndarray:
    """A field that no other step has, in the file's units."""
    x, y, z = points.T
    return (place + 1.0) * np.column_stack([0.01 * x + 0.002 * y**2, -0.003 * x * y, 0.0 * z])


def _write_pvd(path: Path) -> None:
    entries = []
    for place, time in enumerate(TIMES):
        meshio.Mesh(POINTS, CELLS, {"U": _field(place)}).write(path.with_name(f"{path.stem}_{place}.vtu"))
        entries.append(f'<DataSet timestep="{time}" part="0" file="{path.stem}_{place}.vtu"/>')
    path.write_text(f'<VTKFile type="Collection"><Collection>{"".join(entries)}</Collection></VTKFile>')


def _write_xdmf(path: Path) -> None:
    with meshio.xdmf.TimeSeriesWriter(path, data_format="XML") as writer:
        writer.write_points_cells(POINTS, CELLS)
        for place, time in enumerate(TIMES):
            writer.write_data(time, point_data={"displacement": _field(place)})


def _write_med(path: Path) -> None:
    """As salome does: one field of several steps, which meshio's writer does not know."""
    import h5py

    meshio.Mesh(POINTS[:, :2], CELLS, {"DEPL": _field(0)[:, :2]}).write(path)
    with h5py.File(path, "r+") as opened:
        of_field = opened["CHA/DEPL"]
        (first,) = of_field
        for place, time in enumerate(TIMES):
            key = f"{place + 5:020d}{place + 5:020d}"
            opened.copy(of_field[first], of_field, key)
            of_field[key].attrs["PDT"] = time
            (profile,) = of_field[key]["NOE"]
            of_field[key]["NOE"][profile]["CO"][:] = _field(place)[:, :2].ravel(order="F")
        del of_field[first]


def _write_exodus(path: Path) -> None:
    names = ("displ_x", "displ_y", "displ_z")
    with netcdf_file(path, "w") as opened:
        for name, size in {"time_step": None, "num_nodes": len(POINTS), "len_string": 33, "num_nod_var": 3,
                           "num_el_in_blk1": MESH.n_cells, "num_nod_per_el1": 4}.items():
            opened.createDimension(name, size)
        for axis, along in zip("xyz", POINTS.T, strict=True):
            opened.createVariable(f"coord{axis}", "d", ("num_nodes",))[:] = along
        cells = opened.createVariable("connect1", "i", ("num_el_in_blk1", "num_nod_per_el1"))
        cells[:], cells.elem_type = MESH.cells + 1, "QUAD4"
        texts = opened.createVariable("name_nod_var", "c", ("num_nod_var", "len_string"))
        for row, name in enumerate(names):
            texts[row] = np.array(list(name.ljust(33, "\0")), "S1")
        opened.createVariable("time_whole", "d", ("time_step",))[:] = np.array(TIMES)
        for component in range(3):
            values = opened.createVariable(f"vals_nod_var{component + 1}", "d", ("time_step", "num_nodes"))
            for place in range(len(TIMES)):
                values[place] = _field(place)[:, component]


def _write_csv(path: Path) -> None:
    lines = ["time,x,y,u,v"]
    for place, time in enumerate(TIMES):
        rows = np.column_stack([POINTS[:, :2], _field(place)[:, :2]])
        lines += [",".join([repr(time), *map(repr, row)]) for row in rows.tolist()]
    path.write_text("\n".join(lines) + "\n")


WRITERS = {".pvd": _write_pvd, ".xdmf": _write_xdmf, ".med": _write_med, ".e": _write_exodus, ".csv": _write_csv}


@pytest.mark.parametrize("suffix", WRITERS)
def test_every_format_gives_the_field_of_the_chosen_step(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"simulated{suffix}"
    WRITERS[suffix](path)
    assert [(step.number, step.time) for step in list_steps(path)] == list(enumerate(TIMES, start=1))
    for place, chosen in enumerate([{"step": 1}, {"time": 1.0}, {"step": -1}]):
        read = read_simulation(path, MAPPING, 2, **chosen)
        assert read.step.number == place + 1
        in_pixels = MAPPING.to_pixels(POINTS[:, :2])
        wanted = MAPPING.scale * _field(place)[:, :2] @ MAPPING.get_axes(2).T
        # At the nodes, whatever their order and the cells; the files hold doubles.
        found = interpolate(read.mesh, read.displacement, in_pixels)
        assert np.abs(found - wanted).max() < 1e-9


@pytest.mark.parametrize("suffix", WRITERS)
def test_no_step_is_taken_unasked_and_a_missing_one_is_an_error(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"simulated{suffix}"
    WRITERS[suffix](path)
    with pytest.raises(InputError, match=r"holds 3 steps \(1, time 0.5; 2, time 1; 3, time 2.5\); choose one"):
        read_simulation(path, MAPPING, 2)
    with pytest.raises(InputError, match=r"holds no step 4; steps are 1, time 0.5"):
        read_simulation(path, MAPPING, 2, step=4)
    with pytest.raises(InputError, match=r"no steps have the time 0.7; steps are 1, time 0.5"):
        read_simulation(path, MAPPING, 2, time=0.7)


def test_frd_holds_two_steps_of_quadratic_quadrangles() -> None:
    """CalculiX 2.20: a strip of 20 x 10, E = 1000, nu = 0.3, stretched by 6 and 12 a unit of length."""
    path = SAMPLES / "plane_quad8.frd"
    assert [step.describe() for step in list_steps(path)] == ["1 (step 1.1), time 1", "2 (step 2.1), time 2"]
    for step, stress in ((1, 6.0), (2, 12.0)):
        read = read_simulation(path, Similarity(), 2, step=step)
        points = np.array([[3.0, 2.0], [12.0, 7.0], [5.0, 5.0]])
        strain = stress / 1000.0
        wanted = points * [strain, -0.3 * strain]
        # Six digits in the file.
        assert np.abs(interpolate(read.mesh, read.displacement, points) - wanted).max() < 1e-6


def test_frd_puts_the_sides_between_the_faces_of_a_hexahedron_before_those_of_the_second() -> None:
    read = read_simulation(SAMPLES / "hexahedron20.frd", Similarity(), 3)
    assert read.mesh.n_cells == 8
    # Pulled by 156 on a face of 80, held on the other; lengths 10, 10, 8: shares of the force are those of a face.
    inner = np.array([[4.0, 5.0, 4.0], [6.0, 3.0, 2.0]])
    assert np.isfinite(interpolate(read.mesh, read.displacement, inner)).all()
    # Volumes of the parts add up to that of the cell only where its sides are where they should be.
    volumes = np.abs([np.linalg.det(_jacobian(read.mesh.nodes[cell])) for cell in read.mesh.cells])
    assert volumes.sum() == pytest.approx(800.0)


def _jacobian(corners: np.ndarray) -> np.ndarray:
    return corners[[1, 3, 4]] - corners[0]


@pytest.mark.parametrize(("kind", "dim"), [("triangle6", 2), ("quad8", 2), ("quad9", 2), ("tetra10", 3),
                                           ("hexahedron20", 3)])
def test_split_cells_hold_the_values_of_their_own_shape_functions(kind: str, dim: int) -> None:
    corners = {"triangle6": [[0, 0], [1, 0], [0, 1]], "quad8": [[0, 0], [1, 0], [1, 1], [0, 1]],
               "quad9": [[0, 0], [1, 0], [1, 1], [0, 1]],
               "tetra10": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
               "hexahedron20": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1],
                                [0, 1, 1]]}[kind]
    sides = {"triangle6": [(0, 1), (1, 2), (2, 0)], "quad8": [(0, 1), (1, 2), (2, 3), (3, 0)],
             "quad9": [(0, 1), (1, 2), (2, 3), (3, 0)],
             "tetra10": [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
             "hexahedron20": [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4),
                              (0, 4), (1, 5), (2, 6), (3, 7)]}[kind]
    ends = np.array(corners, dtype=float)
    points = np.concatenate([ends, ends[np.array(sides)].mean(axis=1)])
    if kind == "quad9":
        points = np.concatenate([points, [[0.5, 0.5]]])
    # A quadratic polynomial without the terms that no serendipity cell has.
    values = (points**2).sum(axis=1, keepdims=True) + points[:, :1] * points[:, 1:2]
    cells = [meshio.CellBlock(kind, np.arange(len(points))[None])]
    new_points, blocks, new_values = split_quadratic_cells(points, cells, values)
    assert new_values == pytest.approx((new_points**2).sum(axis=1, keepdims=True)
                                       + new_points[:, :1] * new_points[:, 1:2], abs=1e-14)
    (block,) = blocks
    at_corners = new_points[block.data]
    if block.type in ("triangle", "tetra"):
        sizes = np.linalg.det(at_corners[:, 1:] - at_corners[:, :1]) / (2.0 if dim == 2 else 6.0)
    else:
        sizes = np.linalg.det(at_corners[:, [1, 3] if dim == 2 else [1, 3, 4]] - at_corners[:, :1])
    whole = {"triangle6": 1 / 2, "tetra10": 1 / 6}.get(kind, 1.0)
    assert (sizes > 0).all()
    assert sizes.sum() == pytest.approx(whole)


def test_a_table_of_points_does_not_bridge_a_hole(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(0.0, 100.0, (3000, 2))
    points = points[np.linalg.norm(points - 50.0, axis=1) > 25.0]
    path = tmp_path / "points.csv"
    np.savetxt(path, np.column_stack([points, 0.1 * points]), delimiter=",", header="X,Y,U,V", comments="")
    read = read_simulation(path, Similarity(), 2)
    assert np.isnan(interpolate(read.mesh, read.displacement, np.array([[50.0, 50.0], [60.0, 45.0]]))).all()
    assert interpolate(read.mesh, read.displacement, np.array([[15.0, 20.0]])) == pytest.approx(
        np.array([[1.5, 2.0]]))


@pytest.mark.parametrize(("fields", "asked", "message"), [
    ({"stress": np.ones((20, 3))}, None, r'vectors there: "stress"; name the one'),
    ({"U": np.ones((20, 3)), "displacement": np.ones((20, 3))}, None, r'vectors there: "U", "displacement"'),
    ({"U": np.ones((20, 3))}, "V", r'has not a vector "V" on its nodes; vectors there: "U"'),
    ({}, None, r"vectors there: none"),
])
def test_a_field_that_is_not_clear_is_not_guessed(tmp_path: Path, fields: dict[str, np.ndarray], asked: str | None,
                                                  message: str) -> None:
    path = tmp_path / "simulated.vtu"
    meshio.Mesh(POINTS, CELLS, fields).write(path)
    with pytest.raises(InputError, match=message):
        read_simulation(path, MAPPING, 2, field=asked)


@pytest.mark.parametrize("suffix", [*WRITERS, ".frd", ".vtu"])
def test_a_damaged_file_is_named(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"damaged{suffix}"
    path.write_bytes(b"\x89HDF\r\n nothing of the kind")
    with pytest.raises(InputError, match=rf"damaged{suffix}: "):
        read_simulation(path, MAPPING, 2)
    with pytest.raises(InputError, match=r"missing.vtu: no such simulation"):
        read_simulation(tmp_path / "missing.vtu", MAPPING, 2)

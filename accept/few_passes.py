"""Iterations of Gauss-Newton on clean and real pairs, and their fields beside those of an older commit.

Nodes are compared where the older field is right: where it counts no cell about a node as excluded or doubtful. What
shows something else than the specimen is told by thresholds, and pixels near these come and go with the last look: both
fields are of the same data only where the same pixels count all about. Elsewhere they may differ by their noise.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial

import meshio
import numpy as np
import tifffile
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from accept.cracks import FRACTURE_CUT_OFF, make_fracture_mesh
from accept.table import Scale
from bench.support.before import checkout_before
from bench.support.paper_case import FULL_WAVELENGTH, HEIGHT, WIDTH, describe_tension, name_images
from bench.support.rows import Row, append_result
from bench.support.runs import DATA, ddic_command, ddic_run, mpirun, real_data
from ddic.images.window import Window
from ddic.io.image_file import open_image
from ddic.io.result_reader import Result, read_result
from ddic.visibility.cell_errors import DOUBTFUL_PX

Array = NDArray[np.float64]

TODAY = "f43a80d"
"""Commit whose fields are compared with."""

TIGHT = """[gauss_newton]
tolerance = 1e-9
rms_tolerance = 1e-6
largest_tolerance = 1e-5
max_iterations = 3000
"""
"""With which the older commit comes to rest, also where it would stop while nodes still move."""

EQUAL_PX, OF_SIGMA = 1e-3, 0.1
"""Largest difference of a node: pixels or, where that is more, a share of the node's own standard deviation, for a node
has converged below a twentieth of that."""

OF_OTHER_PIXELS = 3.0
"""The same share where other pixels count: the largest of a thousand normal deviations is 3.2 of them."""

REACH = 1.5
"""Cut-off wavelengths over which pixels decide on a node: by 1 + (l_c k / 2 pi)^4 mechanics carry what pixels tell as
exp(-sqrt(2) pi r / l_c), a thousandth of it that far."""

WIDTH_OF_STRIP = (536, 8, 856, 1032)
"""Of the strip on openhole's images, edge to edge and with the hole, pixels: whole elements of 8 and 16 px."""


@dataclass(frozen=True)
class PassCase:
    """A pair, and how many iterations it may take.

    Attributes
    ----------
    what : str
        The pair in words.
    most : int
        Iterations.
    describe : callable
        Gives the case file without output and tolerances; makes what it names.
    n_ranks : int
        Of the run.
    knows_noise : bool
        Whether standard deviations of nodes are estimated, which takes long on large meshes.
    reach : float
        Distance over which pixels decide on a node, pixels: three elements, or REACH cut-off wavelengths.
    """

    what: str
    most: int
    describe: Callable[[Scale], str]
    n_ranks: int = 1
    knows_noise: bool = True
    reach: float = 48.0


def _describe_tension(paint: bool, scale: Scale) -> str:
    """A plate with a hole in tension; a smoke run takes a small image."""
    folder = scale.folder("tension_painted" if paint else "tension")
    return describe_tension(folder, (512, 512) if scale.smoke else (WIDTH, HEIGHT), paint_hole=paint)


def _describe_openhole(number: int, element: int | None, scale: Scale) -> str:
    """Frame 53 to another one; on the given mesh, or on squares over the whole strip."""
    del scale
    folder = real_data() / "openhole"
    mesh = (f'[mesh]\nfile = "{folder}/mesh_q4_pixels.msh"\n' if element is None else
            f"[mesh.structured]\nregion = {list(WIDTH_OF_STRIP)}\nelement_size = {element}\n")
    return name_images(folder / "zoom-0053_1.tif", folder / f"zoom-{number:04d}_1.tif") + mesh


def _describe_fracture(number: int, cut_off: float | None, scale: Scale) -> str:
    """Frame 0 to another one on the specimen; frame 0 is cut to the others' size, its first columns and rows."""
    folder, made = real_data() / "fracture", scale.folder("fracture")
    made.mkdir(parents=True, exist_ok=True)
    deformed = folder / f"img_{number:04d}.png"
    shown, whole = open_image(deformed), open_image(folder / "img_0000.tif")
    tifffile.imwrite(made / "frame_0.tif", whole.read(Window(0, 0, shown.width, shown.height)))
    nodes, cells = make_fracture_mesh()
    points = np.pad(nodes, ((0, 0), (0, 1)))
    meshio.write(made / "specimen.vtk", meshio.Mesh(points, [("quad", cells)]), file_format="vtk")
    regularization = "" if cut_off is None else f"[regularization]\ncut_off_wavelength = {cut_off:g}\n"
    return (name_images(made / "frame_0.tif", deformed) + f'[mesh]\nfile = "{made}/specimen.vtk"\n' + regularization)


TENSION: Mapping[str, PassCase] = {
    f"tension{name}": PassCase(words, 8, partial(_describe_tension, paint), 2, knows_noise=False)
    for name, words, paint in (("", "speckles in the hole", False), ("_painted", "a dark hole", True))}

OPENHOLE: Mapping[str, PassCase] = {
    "openhole_70": PassCase("53 to 70", 6, partial(_describe_openhole, 70, None)),
    "openhole_78": PassCase("53 to 78", 12, partial(_describe_openhole, 78, None))}

FRACTURE: Mapping[str, PassCase] = {
    f"fracture_{number}{name}": PassCase(f"0 to {number}{words}", most, partial(_describe_fracture, number, cut_off),
                                         reach=REACH * cut_off if cut_off else 48.0)
    for number, most in ((60, 12), (120, 20))
    for name, words, cut_off in (("", "", None), ("_lc", f", l_c = {FRACTURE_CUT_OFF} px", FRACTURE_CUT_OFF))}

STRIP: Mapping[str, PassCase] = {
    f"strip_{number}_{element}": PassCase(f"53 to {number}, {element} px", 10,
                                          partial(_describe_openhole, number, element))
    for number in (54, 62) for element in (8, 16)}


def measure_tension(scale: Scale) -> list[Row]:
    """Count the iterations of a large clean pair."""
    size = "512 x 512 px" if scale.smoke else f"{WIDTH} x {HEIGHT} px, 28 Mpx, 221,136 unknowns"
    return [_measure(f"plate with a hole in tension, {size}, l_c = {FULL_WAVELENGTH} px, 2 ranks", TENSION, scale)]


def measure_real_pairs(scale: Scale) -> list[Row]:
    """Count the iterations of real pairs."""
    if scale.smoke:
        return [_measure("openhole", {"openhole_70": OPENHOLE["openhole_70"]}, scale)]
    return [_measure("openhole, given mesh, no l_c", OPENHOLE, scale),
            _measure("fracture, 16-px Q4 on the specimen, frame 0 cut to the size of the others", FRACTURE, scale),
            _measure("openhole, structured over the whole width with the hole, no l_c", STRIP, scale)]


def _measure(what: str, cases: Mapping[str, PassCase], scale: Scale) -> Row:
    told, holds = [], True
    for name, case in cases.items():
        text = case.describe(scale)
        folder = scale.folder("clean_passes")
        summary = ddic_run(text, folder, case.n_ranks, name)
        good = summary["iterations"] <= case.most
        words = (f"{case.what}: {summary['iterations']} iterations, and {summary['local_iterations']} of slow nodes "
                 "alone")
        if not scale.smoke:
            before, now = measure_before(name, case, text), read_result(folder / f"{name}.vtkhdf")
            change = compare_fields(before, now, case.reach)
            good &= change.are_equal
            words += f", {change.describe()}"
            append_result("clean_passes", {"case": name, "iterations": summary["iterations"], **asdict(change)})
        told.append(words if good else f"{words} (MISSED)")
        holds &= good
    most = "at most " + ", ".join(f"{case.what}: {case.most}" for case in cases.values())
    equal = (f"no node that is right at {TODAY}, run tightly, differs by more than {EQUAL_PX:g} px or {OF_SIGMA:g} of "
             f"its standard deviation where the same pixels count, {OF_OTHER_PIXELS:g} elsewhere")
    return Row(f"{what}: iterations", most if scale.smoke else f"{most}; {equal}", "; ".join(told), holds)


def measure_before(name: str, case: PassCase, text: str) -> Result:
    """Measure a pair by the older commit until it rests, or read what it measured before."""
    folder = DATA / "clean_passes" / TODAY
    folder.mkdir(parents=True, exist_ok=True)
    output = f'[output]\nfile = "{name}.vtkhdf"\n' + ("uncertainty = true\n" if case.knows_noise else "")
    whole = f"{text}{TIGHT}{output}"
    path, stamp = folder / f"{name}.toml", folder / f"{name}.stamp"
    wanted = hashlib.sha256(whole.encode()).hexdigest()
    if not stamp.is_file() or stamp.read_text(encoding="utf-8") != wanted:
        path.write_text(whole, encoding="utf-8")
        source = checkout_before(TODAY) / "src"
        mpirun(case.n_ranks, ddic_command(), "run", str(path), changes={"PYTHONPATH": str(source)})
        stamp.write_text(wanted, encoding="utf-8")
    return read_result(path.with_suffix(".vtkhdf"))


@dataclass(frozen=True)
class FieldChange:
    """How far two fields are apart where the first is right.

    Attributes
    ----------
    n_nodes : int
        All nodes.
    same, other : NodeChange
        Of right nodes about which the same pixels count, and of the others.
    n_other_pixels : int
        By which the numbers of pixels that count differ, cell by cell.
    """

    n_nodes: int
    same: NodeChange
    other: NodeChange
    n_other_pixels: int

    @property
    def are_equal(self) -> bool:
        """Whether each node is as near as asked."""
        return self.same.of_sigma <= OF_SIGMA and self.other.of_sigma <= OF_OTHER_PIXELS

    def describe(self) -> str:
        """In words."""
        words = f"{self.same.n_nodes + self.other.n_nodes} of {self.n_nodes} nodes right, {self.same.describe()}"
        if not self.other.n_nodes:
            return words
        return f"{words}; within reach of {self.n_other_pixels} pixels that one counts alone {self.other.describe()}"


@dataclass(frozen=True)
class NodeChange:
    """How far some nodes are apart.

    Attributes
    ----------
    n_nodes : int
        Of them.
    largest : float
        Of a node, pixels.
    of_sigma : float
        The same among nodes that differ by more than EQUAL_PX, over the node's standard deviation; infinite where
        that is not known, 0 where no node differs as much.
    n_beyond : int
        Those nodes.
    """

    n_nodes: int
    largest: float
    of_sigma: float
    n_beyond: int

    def describe(self) -> str:
        """In words."""
        share = "not known how far within noise" if np.isinf(self.of_sigma) else f"to {self.of_sigma:.2f} sigma"
        beyond = f", {self.n_beyond} beyond {EQUAL_PX:g} px ({share})" if self.n_beyond else ""
        return f"{self.n_nodes} differ by at most {self.largest:.1e} px{beyond}"


def compare_fields(before: Result, now: Result, reach: float) -> FieldChange:
    """Compare two fields of the same mesh.

    Parameters
    ----------
    before, now : Result
        Of the same pair.
    reach : float
        Distance over which pixels decide on a node, pixels.

    Returns
    -------
    FieldChange
        Where ``before`` is right.
    """
    complained = (before.cell_data["excluded"] > 0) | (before.cell_data["doubtful"] > 0)
    is_right = before.measured_nodes.copy()
    is_right[np.unique(before.mesh.cells[complained])] = False
    sigma = _find_sigma(before)
    if sigma is not None:
        # Where the texture tells a node to worse than that, in a dark hole say, nobody knows which field is right.
        is_right &= sigma <= DOUBTFUL_PX
    change = np.linalg.norm(now.displacement - before.displacement, axis=1)
    # A node that has no value any more is off by anything.
    change = np.where(np.isfinite(change), change, np.inf)
    lost = np.abs(before.cell_data["residual_n_pixels"] - now.cell_data["residual_n_pixels"])
    is_near = _find_nodes_near(before, lost > 0, reach)
    same, other = (_compare_nodes(change, sigma, is_right & chosen) for chosen in (~is_near, is_near))
    return FieldChange(len(is_right), same, other, int(lost.sum()))


def _find_nodes_near(result: Result, cells: NDArray[np.bool_], reach: float) -> NDArray[np.bool_]:
    """Which nodes are within reach of the centre of some cells, (n_nodes,)."""
    if not cells.any():
        return np.zeros(len(result.mesh.nodes), dtype=bool)
    centres = result.mesh.nodes[result.mesh.cells[cells]].mean(axis=1)
    return np.asarray(cKDTree(centres).query(result.mesh.nodes)[0] <= reach)


def _compare_nodes(change: Array, sigma: Array | None, chosen: NDArray[np.bool_]) -> NodeChange:
    is_beyond = chosen & (change > EQUAL_PX)
    of_sigma = 0.0
    if is_beyond.any():
        of_sigma = np.inf if sigma is None else float((change / sigma)[is_beyond].max())
    return NodeChange(int(chosen.sum()), float(change[chosen].max(initial=0.0)), of_sigma, int(is_beyond.sum()))


def _find_sigma(result: Result) -> Array | None:
    """Standard deviation of a node's displacement, (n_nodes,), pixels; None where it was not estimated."""
    if "sigma_u" not in result.point_data:
        return None
    return np.asarray(np.hypot(result.point_data["sigma_u"], result.point_data["sigma_v"]))

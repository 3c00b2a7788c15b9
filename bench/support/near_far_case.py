"""Near-field and far-field cases: their text, each camera measured alone on its own elements, errors, oscillation.

And four panels of strain: far and near field measured alone, continuous, regularized. Those of Fig. 4 of [BP17] are
meshes displaced 30 times: as measured, less alpha0, by Eq. 21, by Eq. 23.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from bench.support.runs import ddic_command, ddic_run, images
from ddic.images.camera import CameraMapping, identity
from ddic.io.result_reader import Result, read_result
from ddic.kinematics.strain import compute_strain
from ddic.mesh.mesh import Mesh
from ddic.plots.canvas import (
    WIDTH_INCHES,
    Bounds,
    ColourScale,
    draw_cell_colours,
    find_mesh_bounds,
    save_figure,
    set_bounds,
)
from ddic.plots.maps import draw_outlines, find_points_inside
from ddic.synth.truth import NearFarTruth, load_near_far_truth

EDGE = 47.5
"""Edge of the far image without elements, far px."""

SAME_NODE = 1e-6
"""Distance within which nodes of two files are one, pixels."""


@dataclass(frozen=True)
class Scene:
    """Synthetic far and near images and the mesh on them.

    Attributes
    ----------
    width, height : int
        Of either image, pixels.
    ratio : float
        Near px per far px.
    alpha : tuple of float
        Translation of the near set-up, far px.
    element_size : float
        Side of the elements, far px.
    folder : Path
        Where images go, a folder for each noise.
    """

    width: int
    height: int
    ratio: float
    alpha: tuple[float, float]
    element_size: float
    folder: Path

    def plate(self, truth_file: Path) -> str:
        """Give the mesh section of the plate with a hole over the far image."""
        hole = json.loads(truth_file.read_text(encoding="utf-8"))["hole"]
        region = [EDGE, EDGE, self.width - 1 - EDGE, self.height - 1 - EDGE]
        return (f"[mesh.structured]\nregion = {region}\nelement_size = {self.element_size:g}\n"
                f"circles = [{{ center = {hole['center']}, radius = {hole['radius']} }}]\n")


@dataclass(frozen=True)
class Pair:
    """The images of one camera and where it looks.

    Attributes
    ----------
    reference, deformed : Path
        Its pictures.
    mapping : CameraMapping
        From the specimen to its pixels.
    noise : float, optional
        Given standard deviation of a picture, grey levels; None if it is estimated.
    """

    reference: Path
    deformed: Path
    mapping: CameraMapping
    noise: float | None = None

    def keys(self) -> str:
        """Its keys of a case file, without those of the mapping."""
        noise = "" if self.noise is None else f"noise = {self.noise}\n"
        return f'reference = "{self.reference}"\ndeformed = "{self.deformed}"\n{noise}'


@dataclass(frozen=True)
class Alone:
    """What one camera measures by itself on its elements.

    Attributes
    ----------
    nodes : (n,) array
        Numbers in the joint mesh.
    seen : (n, 2) array
        Displacement as if its set-up had not moved, far px.
    residual_std : float
        Grey levels.
    """

    nodes: NDArray[np.int64]
    seen: NDArray[np.float64]
    residual_std: float


@dataclass(frozen=True)
class Fields:
    """A field that may jump between cameras: nodes and displacement of each, and what each of them measured.

    Attributes
    ----------
    mesh : Mesh
        Of both.
    cells : (n_cells,) array
        Number of the camera.
    nodes : list of (n_c,) arrays
        Numbers in ``mesh`` of each camera's.
    u : list of (n_c, 2) arrays
        Their displacements, far px.
    alpha : (n_alpha,) array
        Motion of the near set-up.
    """

    mesh: Mesh
    cells: NDArray[np.int64]
    nodes: list[NDArray[np.int64]]
    u: list[NDArray[np.float64]]
    alpha: NDArray[np.float64]


def render_scene(scene: Scene, noise: float, seed: int = 0) -> tuple[Pair, Pair, NearFarTruth]:
    """Render the images of a scene, where they are missing.

    Parameters
    ----------
    scene : Scene
        Sizes.
    noise : float
        Standard deviation, grey levels.
    seed : int
        Of speckles and noise.

    Returns
    -------
    far, near : Pair
        The images.
    truth : NearFarTruth
        The exact field.
    """
    folder = images("near-far", "--size", f"{scene.width}x{scene.height}", "--ratio", str(scene.ratio), "--alpha",
                    *map(str, scene.alpha), "--noise", str(noise), "--seed", str(seed),
                    folder=scene.folder / f"noise{noise:g}_seed{seed}")
    truth = load_near_far_truth(folder / "truth.json")
    far, near = (Pair(folder / f"{name}_reference.tif", folder / f"{name}_deformed.tif", mapping)
                 for name, mapping in (("far", identity()), ("near", truth.mapping)))
    return far, near, truth


def joint_case(far: Pair, near: Pair, mesh: str, rest: str) -> str:
    """Text of a case with one near-field image; the near camera's mapping must be a similarity without rotation."""
    h = near.mapping.homography
    return (f"[images]\n{far.keys()}[[near]]\n{near.keys()}ratio = {float(h[0, 0])!r}\n"
            f"offset = [{float(h[0, 2])!r}, {float(h[1, 2])!r}]\n{mesh}{rest}")


def measured_alone(joint: Result, camera: int, pair: Pair, folder: Path, rest: str) -> Alone:
    """FE-DIC of one camera's images alone, on the elements that it measures in a joint result, in its own pixels."""
    part, ids = joint.mesh.create_submesh(np.flatnonzero(joint.cell_data["Camera"] == camera))
    nodes = pair.mapping.to_image(part.nodes)
    name = f"alone_{camera}"
    folder.mkdir(parents=True, exist_ok=True)
    cells = [(block.type.meshio_name, block.nodes) for block in part.cell_blocks]
    meshio.write(folder / f"{name}.vtk", meshio.Mesh(np.pad(nodes, ((0, 0), (0, 1))), cells), file_format="vtk")
    summary = ddic_run(f'[images]\nreference = "{pair.reference}"\ndeformed = "{pair.deformed}"\n'
                       f'[mesh]\nfile = "{name}.vtk"\n{rest}', folder, 1, name)
    result = read_result(folder / f"{name}.vtkhdf")
    distance, at = cKDTree(nodes).query(result.mesh.nodes)
    if len(at) != len(ids) or distance.max() > SAME_NODE:
        raise RuntimeError(f"{folder / name}: the result's nodes are not those of its mesh")
    seen = pair.mapping.to_specimen(result.mesh.nodes + result.displacement) - joint.mesh.nodes[ids[at]]
    order = np.argsort(at)
    return Alone(ids, seen[order], summary["residual_std_grey"])


def independent(joint: Result, alone: Sequence[Alone]) -> Fields:
    """Fields of two cameras measured alone; alpha leaves the least jumps between them, Eq. 22 of [BP17]."""
    far, near = alone
    _, at_far, at_near = np.intersect1d(far.nodes, near.nodes, return_indices=True)
    alpha = (near.seen[at_near] - far.seen[at_far]).mean(axis=0)
    return Fields(joint.mesh, joint.cell_data["Camera"].astype(np.int64), [far.nodes, near.nodes],
                  [far.seen, near.seen - alpha], alpha)


def continuous(joint: Result) -> Fields:
    """The one field of a joint result, as fields of its cameras."""
    cells = joint.cell_data["Camera"].astype(np.int64)
    nodes = [joint.mesh.create_submesh(np.flatnonzero(cells == camera))[1] for camera in range(2)]
    return Fields(joint.mesh, cells, nodes, [joint.displacement[n] for n in nodes], alpha_of(joint))


def calibrate_command(far: Path, near: Path, ratio: float) -> list[str]:
    """Command that finds where a near reference image lies in a far one, from a rough ratio."""
    return [ddic_command(), "calibrate", str(far), str(near), "--ratio", str(ratio)]


def alpha_of(joint: Result) -> NDArray[np.float64]:
    """Measured translation of the near set-up, far px (2,)."""
    return np.asarray(joint.attributes["near_1"]["alpha_px"])


def rms(values: NDArray[np.float64]) -> float:
    """Root mean square of components."""
    return float(np.sqrt(np.mean(np.square(values))))


Exact = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def errors(fields: Fields, exact: Exact) -> list[NDArray[np.float64]]:
    """Error of each camera's field at its nodes, (n_c, 2) far px."""
    return [u - exact(fields.mesh.nodes[nodes]) for nodes, u in zip(fields.nodes, fields.u, strict=True)]


def error_rms(fields: Fields, exact: Exact) -> float:
    """RMS error per component over both fields; a node of both counts in each."""
    return rms(np.concatenate(errors(fields, exact)))


def interface(fields: Fields) -> NDArray[np.int64]:
    """Nodes of both cameras."""
    far, near = fields.nodes
    return np.asarray(np.intersect1d(far, near))


def interface_error(fields: Fields, exact: Exact) -> float:
    """RMS error per component of both fields at the nodes that they share."""
    shared = interface(fields)
    return rms(np.concatenate([e[np.isin(n, shared)] for e, n in zip(errors(fields, exact), fields.nodes,
                                                                     strict=True)]))


def largest_jump(fields: Fields) -> float:
    """Largest difference of a component between the two fields at the nodes that they share, far px."""
    shared = interface(fields)
    far, near = (u[np.searchsorted(n, shared)] for n, u in zip(fields.nodes, fields.u, strict=True))
    return float(np.abs(far - near).max())


def oscillation(fields: Fields, exact: Exact) -> float:
    """RMS of the second difference e_a - 2 e_b + e_c of the error, per component, far px.

    b runs over the nodes of both cameras, a and c over its two neighbours on each mesh line through b, along the
    interface as well as across it. Where fields jump, b and neighbours on the interface count once for each field,
    both in the same one; a neighbour inside has its camera's value.
    """
    nodal = []
    for e, nodes in zip(errors(fields, exact), fields.nodes, strict=True):
        values = np.full((fields.mesh.n_nodes, 2), np.nan)
        values[nodes] = e
        nodal.append(values)
    differences = []
    shared = interface(fields)
    for a, b, c in mesh_lines(fields.mesh, shared):
        for own, other in (nodal, nodal[::-1]):
            ends = [np.where(np.isnan(own[k]), other[k], own[k]) for k in (a, c)]
            differences.append(ends[0] - 2 * own[b] + ends[1])
    return rms(np.array(differences))


def mesh_lines(mesh: Mesh, nodes: NDArray[np.int64]) -> Iterator[tuple[int, int, int]]:
    """Neighbours a, c of node b on each mesh line through it, where four quadrilaterals meet at b."""
    wanted = set(nodes.tolist())
    cells_at: dict[int, list[list[int]]] = {node: [] for node in wanted}
    for cell in mesh.cells:
        corners = [int(k) for k in cell if k >= 0]
        for k, corner in enumerate(corners):
            if corner in wanted:
                cells_at[corner].append([corners[k - 1], corners[(k + 1) % len(corners)], len(corners)])
    for b, around in sorted(cells_at.items()):
        if len(around) != 4 or any(n != 4 for *_, n in around):
            continue
        next_to: dict[int, set[int]] = {}
        for one, two, _ in around:
            next_to.setdefault(one, set()).add(two)
            next_to.setdefault(two, set()).add(one)
        for a in sorted(next_to):
            opposite = set(next_to) - {a} - next_to[a]
            if len(opposite) == 1 and a < (c := opposite.pop()):
                yield a, b, c


AROUND = 0.35


HIDDEN_PERCENT = 0.5
"""Share of the values, on either side, that colours do not span; a larger value shows more of what is between."""


@dataclass(frozen=True)
class CellPanel:
    """Cells in colour.

    Attributes
    ----------
    title : str
        Above the panel.
    mesh : Mesh
        In pixels of the far field.
    values : (n_cells,) array
        Of its cells.
    """

    title: str
    mesh: Mesh
    values: NDArray[np.float64]


def draw_panels(fields: Mapping[str, Fields], path: Path) -> None:
    """Strain along y around the near field; fields: independent, continuous, regularized."""
    alone, joint, regularized = (fields[name] for name in ("independent", "continuous", "regularized"))
    near = alone.mesh.create_submesh(np.flatnonzero(alone.cells == 1))[0]
    panels = [_panel("(a) far field alone", alone, [0]), _panel("(b) near field alone", alone, [1]),
              _panel("(c) continuous, Eq. 21", joint, [0, 1]), _panel("(d) regularized, Eq. 23", regularized, [0, 1])]
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(draw_cell_panels(panels, [near], find_mesh_bounds(near.nodes, AROUND), r"$\varepsilon_{yy}$ [-]"), path)


def _panel(title: str, fields: Fields, cameras: list[int]) -> CellPanel:
    shown = fields.mesh.create_submesh(np.flatnonzero(np.isin(fields.cells, cameras)))[0]
    values = np.concatenate([_strain(fields, camera) for camera in cameras])
    order = np.argsort(np.concatenate([np.flatnonzero(fields.cells == camera) for camera in cameras]))
    return CellPanel(title, shown, values[order])


def _strain(fields: Fields, camera: int) -> NDArray[np.float64]:
    part, _ = fields.mesh.create_submesh(np.flatnonzero(fields.cells == camera))
    return compute_strain(part, fields.u[camera].ravel()).infinitesimal[:, 1]


def draw_cell_panels(panels: Sequence[CellPanel], outlined: Sequence[Mesh], box: Bounds, label: str) -> Figure:
    """Draw panels of one part of the image with common colours, two in a row, at least one.

    Colours span what the last panel shows, without the outermost 0.5 % on either side. ``box`` is x0, y0, x1, y1 of the
    part, pixels; the outlines of ``outlined`` are drawn in all panels.
    """
    last = panels[-1]
    centres = np.array([last.mesh.nodes[cell[cell >= 0]].mean(axis=0) for cell in last.mesh.cells])
    shown = last.values[find_points_inside(centres, box)]
    low, high = np.nanpercentile(shown, [HIDDEN_PERCENT, 100 - HIDDEN_PERCENT]).tolist()
    figure, all_axes = _page(len(panels), box)
    for axes, panel in zip(all_axes, panels, strict=True):
        cells = draw_cell_colours(axes, panel.mesh, panel.mesh.nodes, panel.values, ColourScale((low, high)))
        draw_outlines(axes, outlined)
        set_bounds(axes, box)
        axes.set_aspect("equal")
        axes.set(xlabel="x [px]", ylabel="y [px]")
        axes.set_title(panel.title, fontsize="medium")
    figure.colorbar(cells, ax=all_axes, label=label, extend="both", shrink=0.7)
    return figure


def _page(n: int, box: Bounds) -> tuple[Figure, list[Axes]]:
    """A page with so many panels for a box of pixels."""
    n_columns = min(n, 2)
    n_rows = math.ceil(n / n_columns)
    x0, y0, x1, y1 = box
    panel_width = WIDTH_INCHES / n_columns
    panel_height = panel_width * (y1 - y0) / (x1 - x0)
    # With room for labels and colour bars, and for the title of the page.
    size = (1.25 * WIDTH_INCHES, 1.1 * n_rows * panel_height + 0.8)
    figure = Figure(figsize=size, layout="constrained")
    return figure, [figure.add_subplot(n_rows, n_columns, k + 1) for k in range(n)]

"""Near-field and far-field cases: their text, each camera measured alone on its own elements, errors."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
from bench.support.runs import DATA, ddic_run, images
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ddic.images.camera import CameraMapping, identity
from ddic.io.result_reader import Result, read_result
from ddic.mesh.mesh import VTK_QUAD, VTK_TRIANGLE, Mesh
from ddic.synth.near_far_truth import NearFarTruth, load_near_far_truth

SIZE = (1392, 1040)
RATIO = 5.0
ALPHA = (3.7, -2.2)
EDGE = 47.5
VTK_NAMES = {VTK_TRIANGLE: "triangle", VTK_QUAD: "quad"}
SAME_NODE = 1e-6


@dataclass(frozen=True)
class Pair:
    """The images of one camera and where it looks; noise: given standard deviation of a picture, None if estimated."""

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

    nodes: (n,) numbers in the joint mesh; seen: displacement as if its set-up had not moved, (n, 2) far px.
    residual_std: grey levels.
    """

    nodes: NDArray[np.int64]
    seen: NDArray[np.float64]
    residual_std: float


@dataclass(frozen=True)
class Fields:
    """A field that may jump between cameras: nodes and displacement of each, and what each of them measured.

    cells: (n_cells,) number of the camera; nodes[c]: (n_c,) numbers in ``mesh``; u[c]: (n_c, 2) far px.
    """

    mesh: Mesh
    cells: NDArray[np.int64]
    nodes: list[NDArray[np.int64]]
    u: list[NDArray[np.float64]]
    alpha: NDArray[np.float64]


def synthetic(noise: float, seed: int = 0) -> tuple[Pair, Pair, NearFarTruth]:
    """The pair of the acceptance table: far and near images and the truth; noise: grey levels."""
    folder = images("near-far", "--size", f"{SIZE[0]}x{SIZE[1]}", "--ratio", str(RATIO), "--alpha", str(ALPHA[0]),
                    str(ALPHA[1]), "--noise", str(noise), "--seed", str(seed),
                    folder=DATA / f"near_far_noise{noise:g}_seed{seed}")
    truth = load_near_far_truth(folder / "truth.json")
    far, near = (Pair(folder / f"{name}_reference.tif", folder / f"{name}_deformed.tif", mapping)
                 for name, mapping in (("far", identity()), ("near", truth.mapping)))
    return far, near, truth


def plate(truth_file: Path, element_size: float) -> str:
    """Mesh section of the plate with a hole over the far image."""
    hole = json.loads(truth_file.read_text(encoding="utf-8"))["hole"]
    return (f"[mesh.structured]\nregion = [{EDGE}, {EDGE}, {SIZE[0] - 1 - EDGE}, {SIZE[1] - 1 - EDGE}]\n"
            f"element_size = {element_size:g}\n"
            f"circles = [{{ center = {hole['center']}, radius = {hole['radius']} }}]\n")


def joint_case(far: Pair, near: Pair, mesh: str, rest: str) -> str:
    """Text of a case with one near-field image; the near camera's mapping must be a similarity without rotation."""
    h = near.mapping.homography
    return (f"[images]\n{far.keys()}[[near]]\n{near.keys()}ratio = {float(h[0, 0])!r}\n"
            f"offset = [{float(h[0, 2])!r}, {float(h[1, 2])!r}]\n{mesh}{rest}")


def measured_alone(joint: Result, camera: int, pair: Pair, folder: Path, rest: str) -> Alone:
    """FE-DIC of one camera's images alone, on the elements that it measures in a joint result, in its own pixels."""
    part, ids = joint.mesh.submesh(np.flatnonzero(joint.cell_data["Camera"] == camera))
    nodes = pair.mapping.to_image(part.nodes)
    name = f"alone_{camera}"
    folder.mkdir(parents=True, exist_ok=True)
    cells = [(VTK_NAMES[int(kind)], part.cells[part.types == kind][:, :3 if kind == VTK_TRIANGLE else 4])
             for kind in np.unique(part.types)]
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
    nodes = [joint.mesh.submesh(np.flatnonzero(cells == camera))[1] for camera in range(2)]
    return Fields(joint.mesh, cells, nodes, [joint.displacement[n] for n in nodes], alpha_of(joint))


def alpha_of(joint: Result) -> NDArray[np.float64]:
    """Measured translation of the near set-up, far px (2,)."""
    return np.asarray(joint.attributes["near_1"]["alpha_px"])


def rms(values: NDArray[np.float64]) -> float:
    """Root mean square of components."""
    return float(np.sqrt(np.mean(np.square(values))))

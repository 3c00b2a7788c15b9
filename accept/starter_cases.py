"""Cases that ``ddic new`` writes for real pairs, measured as written, beside the cases with which these are recorded.

A field is compared where both cases measure it, neither excluded nor doubtful, in units of the noise floor that its own
run states: two fields of different elements differ by the noise of both.
"""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray

import ddic
from accept.cracks import FRACTURE_CUT_OFF, make_fracture_mesh
from accept.support.foam_noise import HOLES, OFFSET, RATIO, REGION
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ddic_command, environment, real_data
from ddic.io.result_schema import DISTRUST, NOISE_FLOOR
from ddic.mesh.interpolation import locate

MOST_FLOORS = 2.0
"""RMS difference of a component, noise floors."""

LIMIT_S = 300

NEAR_REGION = (98, 218, 306, 362)
"""What of the foam the near images show, far pixels, less a margin."""


@dataclass(frozen=True)
class RealPair:
    """A real pair and its recorded case.

    Attributes
    ----------
    name : str
        What it shows.
    images : (str, str)
        Reference and deformed one, from the folder of the real images.
    recorded : str
        TOML of the mesh and of the regularization.
    """

    name: str
    images: tuple[str, str]
    recorded: str


def list_pairs(folder: Path) -> list[RealPair]:
    """List the pairs; what their recorded cases need is written to a folder."""
    nodes, cells = make_fracture_mesh()
    meshio.write(folder / "specimen.vtk", meshio.Mesh(np.pad(nodes, ((0, 0), (0, 1))), [("quad", cells)]),
                 file_format="vtk")
    given = real_data() / "openhole" / "mesh_q4_pixels.msh"
    openhole = f'[mesh]\nfile = "{given}"\n'
    near = _describe_foam(RATIO, OFFSET, 16 * RATIO)
    return [
        RealPair("openhole 53 -> 62", ("openhole/zoom-0053_1.tif", "openhole/zoom-0062_1.tif"), openhole),
        RealPair("openhole 53 -> 70", ("openhole/zoom-0053_1.tif", "openhole/zoom-0070_1.tif"), openhole),
        RealPair("fracture 30 -> 60", ("fracture/img_0030.png", "fracture/img_0060.png"),
                 f'[mesh]\nfile = "{folder}/specimen.vtk"\n'
                 f"[regularization]\ncut_off_wavelength = {FRACTURE_CUT_OFF}\n"),
        RealPair("sample 14, L5", ("dic_challenge_sample14/sample14_ref.tif", "dic_challenge_sample14/sample14_L5.tif"),
                 "[mesh.structured]\nregion = [16, 16, 2032, 576]\nelement_size = 16\n"
                 "[regularization]\ncut_off_wavelength = 48\n"),
        RealPair("foam, far", ("nearfar_foam/far_ref.tif", "nearfar_foam/far_def.tif"),
                 _describe_foam(1, (0.0, 0.0), 16)),
        RealPair("foam, near", ("nearfar_foam/near_ref.tif", "nearfar_foam/near_def.tif"), near),
    ]


def _describe_foam(ratio: int, offset: tuple[float, float], element: int) -> str:
    """The foam's region and holes, given in far pixels, in those of an image of it; what of it that shows."""
    x0, y0, x1, y1 = REGION if ratio == 1 else NEAR_REGION
    corners = [ratio * x0 + offset[0], ratio * y0 + offset[1], ratio * x1 + offset[0], ratio * y1 + offset[1]]
    circles = [f"{{ center = [{ratio * x + offset[0]}, {ratio * y + offset[1]}], radius = {ratio * r} }}"
               for x, y, r in HOLES if x0 - r < x < x1 + r and y0 - r < y < y1 + r]
    return f"[mesh.structured]\nregion = {corners}\nelement_size = {element}\ncircles = [{', '.join(circles)}]\n"


def measure_starters(scale: Scale) -> list[Row]:
    """Measure what ``ddic new`` writes for each pair, beside its recorded case."""
    folder = scale.folder("starters")
    folder.mkdir(parents=True, exist_ok=True)
    pairs = list_pairs(folder)
    return [_compare(pair, folder, number) for number, pair in enumerate(pairs[:1] if scale.smoke else pairs)]


def _compare(pair: RealPair, folder: Path, number: int) -> Row:
    images = [str(real_data() / image) for image in pair.images]
    recorded, started = folder / f"recorded_{number}.toml", folder / f"started_{number}.toml"
    recorded.write_text(f'[images]\nreference = "{images[0]}"\ndeformed = "{images[1]}"\n{pair.recorded}'
                        f'[output]\nfile = "{recorded.stem}.vtkhdf"\n')
    started.unlink(missing_ok=True)
    _run("new", *images, "--output", str(started))
    code = _run("run", str(started))
    _run("run", str(recorded))
    field, other = (ddic.open(path.with_suffix(".vtkhdf")) for path in (started, recorded))
    floor = float(field.attributes["case"][NOISE_FLOOR])
    places = field.mesh.centroids[_is_trusted(field)]
    difference = field.at(places) - other.at(places)
    seen = np.isfinite(difference).all(axis=1) & _is_trusted_at(other, places)
    rms = float(np.sqrt((difference[seen] ** 2).mean()))
    word = "none" if field.verdict is None else field.verdict.word
    return Row(f"{pair.name}: the case of ddic new as written, beside the recorded one at {int(seen.sum())} centres of "
               "cells", f"converges; not distrusted; {MOST_FLOORS:g} noise floors",
               f"exit code {code}; {word}; {rms:.4f} px RMS a component, {rms / floor:.2f} noise floors of "
               f"{floor:.4f} px",
               code == 0 and word != DISTRUST and rms <= MOST_FLOORS * floor)


def _run(*words: str) -> int:
    """Run a command of ddic; return its exit code."""
    return subprocess.run([ddic_command(), *words], env=environment(), timeout=LIMIT_S, check=False,
                          capture_output=True).returncode


def _is_trusted(result: ddic.Result) -> NDArray[np.bool_]:
    """Whether cells are neither excluded nor doubtful."""
    return np.asarray((result.cell_data["excluded"] == 0) & (result.cell_data["doubtful"] == 0))


def _is_trusted_at(result: ddic.Result, places: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether places lie in such cells."""
    cells = locate(result.mesh, places).cells
    return np.asarray((cells >= 0) & _is_trusted(result)[np.maximum(cells, 0)])

"""``python -m ddic.compile_kernels``: compile pixel and voxel kernels into numba's cache, so that no run has to."""

import os
import sys
import tempfile
import time
from itertools import product
from pathlib import Path

SIDES = {2: 128, 3: 48}
"""Side of images and volumes, pixels: enough for a mesh and for the pyramid's coarsest level."""

PAIRS = ((2, 8, 8), (2, 16, 16), (2, 32, 32), (3, 8, 8), (3, 16, 16), (3, 32, 32), (3, 32, 8))
"""Dimensions, bits of f and of g. From a volume of 8 bits a light that varies is taken as floats."""

MASKS = {2: 'reference_mask = "mask.tif"\ndeformed_mask = "mask.tif"', 3: 'mask = "mask.tif"'}

CASE = """
[{imaging}]
reference = "reference.tif"
deformed = "deformed.tif"
{mask}
[mesh.structured]
region = {region}
element_size = 8
[correlation]
spline_degree = {degree}
[regularization]
cut_off_wavelength = 32
[solver]
subdomains = 2
"""


def compile_kernels() -> None:
    """Render small pairs and measure them, with everything that gives a kernel arguments of other types."""
    import petsc4py

    petsc4py.init(["ddic"])
    import cv2
    import numpy as np

    from ddic.mesh.grid import GridLines
    from ddic.mesh.interpolation import interpolate
    from ddic.mesh.repair import check_joints
    from ddic.methods.run import run_case
    from ddic.parallel.team import Team
    from ddic.results.listener import Silence

    cv2.setNumThreads(1)
    team = Team.alone()
    with tempfile.TemporaryDirectory(prefix="ddic-kernels-") as name:
        folder = Path(name)
        for dim, *depths in PAIRS:
            _write_images(folder, dim, depths)
            for degree, mask in product((3, 5) if dim == 2 else (3,), ("", MASKS[dim])):
                region = [8] * dim + [SIDES[dim] - 8] * dim
                text = CASE.format(imaging="images" if dim == 2 else "volumes", region=region, degree=degree, mask=mask)
                (folder / "case.toml").write_text(text, encoding="utf-8")
                run_case(team, folder / "case.toml", Silence())
    for dim in SIDES:
        mesh = GridLines((np.arange(3.0),) * dim).build_mesh()
        interpolate(mesh, mesh.nodes, mesh.centroids)
        check_joints(mesh)


def _write_images(folder: Path, dim: int, depths: list[int]) -> None:
    import numpy as np
    import tifffile

    from ddic.synth.fields import Affine
    from ddic.synth.render import Digitiser, Picture, Scene, render_pair
    from ddic.synth.speckle import SpeckleTexture

    side, sizes = SIDES[dim], (SIDES[dim],) * dim
    field = Affine(tuple(map(tuple, 0.004 * np.eye(dim))), (0.3,) * dim, (side / 2,) * dim)
    of_f, of_g = (render_pair(Scene(SpeckleTexture(3), field), Picture(side, side, Digitiser(bits), *sizes[2:]))
                  for bits in depths)
    mask = np.ones(sizes, np.uint8)
    mask[20:24, 20:24] = 0
    for name, values in (("reference", of_f.reference), ("deformed", of_g.deformed), ("mask", mask)):
        tifffile.imwrite(folder / f"{name}.tif", values)


def compile_and_tell() -> None:
    """Compile, and say how long it took; a second time takes a few seconds."""
    # BLAS reads these when numpy is imported.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    began = time.perf_counter()
    compile_kernels()
    sys.stdout.write(f"kernels compiled in {time.perf_counter() - began:.1f} s\n")


if __name__ == "__main__":
    compile_and_tell()

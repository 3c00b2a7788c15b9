"""``python -m ddic.compile_kernels``: compile the pixel kernels into numba's cache, so that no run has to."""

import os
import sys
import tempfile
import time
from itertools import product
from pathlib import Path

SIDE = 128
"""Side of the images, pixels: enough for a mesh and for the pyramid's coarsest level."""

CASE = """
[images]
reference = "reference.tif"
deformed = "deformed.tif"
{mask}
[mesh.structured]
region = [16, 16, 112, 112]
element_size = 16
[correlation]
spline_degree = {degree}
[regularization]
cut_off_wavelength = 64
[solver]
subdomains = 2
"""


def compile_kernels() -> None:
    """Render small pairs and measure them, with everything that gives a kernel arguments of other types."""
    import petsc4py

    petsc4py.init(["ddic"])
    import cv2

    from ddic.mesh.interpolation import interpolate
    from ddic.mesh.structured import build_structured_mesh
    from ddic.methods.run import run_case
    from ddic.parallel.team import Team
    from ddic.results.listener import Silence

    cv2.setNumThreads(1)
    team = Team.alone()
    with tempfile.TemporaryDirectory(prefix="ddic-kernels-") as name:
        folder = Path(name)
        for bit_depth in (8, 16, 32):
            _write_images(folder, bit_depth)
            for degree, mask in product((3, 5), ("", 'reference_mask = "mask.tif"\ndeformed_mask = "mask.tif"')):
                case = folder / "case.toml"
                case.write_text(CASE.format(degree=degree, mask=mask), encoding="utf-8")
                run_case(team, case, Silence())
    mesh = build_structured_mesh((0, 0, SIDE, SIDE), SIDE / 2)
    interpolate(mesh, mesh.nodes, mesh.centroids)


def _write_images(folder: Path, bit_depth: int) -> None:
    import numpy as np
    import tifffile

    from ddic.synth.fields import Sinusoidal
    from ddic.synth.render import Digitiser, Picture, Scene, render_pair
    from ddic.synth.speckle import SpeckleTexture

    field = Sinusoidal((0.3, -0.2), (0.5, 0.4), (256.0, 320.0), (320.0, 256.0))
    pair = render_pair(Scene(SpeckleTexture(3), field), Picture(SIDE, SIDE, Digitiser(bit_depth)))
    mask = np.ones((SIDE, SIDE), np.uint8)
    mask[60:64, 60:64] = 0
    for name, values in (("reference", pair.reference), ("deformed", pair.deformed), ("mask", mask)):
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

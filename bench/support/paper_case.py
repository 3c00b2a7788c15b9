"""The 29-megapixel cases: the paper's open-hole beam, and a structured mesh of the whole image."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from bench.support.paper_field import OpenHoleBeam
from bench.support.paper_mesh import write_gmsh_mesh
from bench.support.runs import DATA, images, source_version
from ddic.synth.fields import DisplacementField
from ddic.synth.render import Digitiser, Picture, Scene, write_pair
from ddic.synth.speckle import SpeckleTexture
from ddic.synth.truth import load_truth

WIDTH, HEIGHT = 6576, 4384
SUBDOMAINS = 180
TOLERANCE = 1e-3

BEAM = (160.0, 1712.0, 6416.0, 2671.0)
HOLE = ((3287.5, 2191.5), 170.0)
BEAM_ELEMENT, BEAM_WAVELENGTH = 15.0, 150.0
FIELD = OpenHoleBeam(5e-6, *HOLE)

MARGIN, FULL_ELEMENT, FULL_WAVELENGTH = 32, 16, 64


@dataclass(frozen=True)
class BenchCase:
    """An image pair on disk, a case without its output, and the known field.

    element_size: pixels; covered: what part of the image the mesh covers, in words;
    solver: keys of [solver] as it is measured.
    """

    name: str
    bits: int
    folder: Path
    text: str
    field: DisplacementField
    element_size: float
    covered: str
    solver: str = f'method = "dual"\nsubdomains = {SUBDOMAINS}'

    def keyed(self, solver: str) -> str:
        """The case's text with other keys of [solver]."""
        return f"{self.text}\n[solver]\n{solver}\n"

    @property
    def measured(self) -> str:
        """The case as it is measured: ddic's defaults otherwise."""
        return self.keyed(self.solver)

    @property
    def monolithic(self) -> str:
        """The same on one domain."""
        return self.keyed('method = "monolithic"')


def beam(bits: int) -> BenchCase:
    """Four-point bending of an open-hole beam [BP17, 5.3]: unstructured T3/Q4 mesh of 15 px, rendered where missing."""
    folder = DATA / f"paper_{bits}"
    source = [source_version(), _field_version()]
    make_once(folder, {"field": asdict(FIELD), "bits": bits, "size": [WIDTH, HEIGHT], "source": source},
              partial(_render_beam, folder, bits))
    mesh = DATA / "paper_mesh" / "beam.msh"
    make_once(mesh.parent, {"region": BEAM, "hole": HOLE, "element": BEAM_ELEMENT},
              partial(write_gmsh_mesh, mesh, BEAM, BEAM_ELEMENT, HOLE))
    x0, y0, x1, y1 = BEAM
    return BenchCase(f"beam_{bits}", bits, folder, _text(folder, f'[mesh]\nfile = "{mesh}"', BEAM_WAVELENGTH), FIELD,
                     BEAM_ELEMENT, f"the beam, {x1 - x0:.0f} x {y1 - y0:.0f} px without its hole")


def full(bits: int) -> BenchCase:
    """The reference field over the whole image but a margin of 32 px: structured 16-px Q4, l_c of four of them."""
    folder = images("sinusoidal", "--size", f"{WIDTH}x{HEIGHT}", "--bit-depth", str(bits),
                    folder=DATA / ("full_size" if bits == 16 else f"full_size_{bits}"))
    mesh = (f"[mesh.structured]\nregion = [{MARGIN}, {MARGIN}, {WIDTH - MARGIN}, {HEIGHT - MARGIN}]\n"
            f"element_size = {FULL_ELEMENT}")
    return BenchCase(f"full_{bits}", bits, folder, _text(folder, mesh, FULL_WAVELENGTH),
                     load_truth(folder / "truth.json"), FULL_ELEMENT, f"all but a margin of {MARGIN} px",
                     'method = "conjugate_gradient"')


def tiny() -> BenchCase:
    """Make a case that takes a second, to see that everything runs.

    Returns
    -------
    BenchCase
        The reference field on 256 x 256 px.
    """
    size = 256
    folder = images("sinusoidal", "--size", f"{size}x{size}", folder=DATA / "smoke" / "paper_tiny")
    mesh = (f"[mesh.structured]\nregion = [{MARGIN}, {MARGIN}, {size - MARGIN}, {size - MARGIN}]\n"
            f"element_size = {FULL_ELEMENT}")
    return BenchCase("tiny", 8, folder, _text(folder, mesh, FULL_WAVELENGTH), load_truth(folder / "truth.json"),
                     FULL_ELEMENT, f"all but a margin of {MARGIN} px", 'method = "dual"\nsubdomains = 4')


CASES: dict[str, Callable[[], BenchCase]] = {
    "beam_8": partial(beam, 8), "beam_16": partial(beam, 16), "full_16": partial(full, 16), "tiny": tiny}
MEASURED = ("beam_8", "beam_16", "full_16")
"""Cases that a table shows."""


def _text(folder: Path, mesh: str, wavelength: float) -> str:
    return (f'[images]\nreference = "{folder}/reference.tif"\ndeformed = "{folder}/deformed.tif"\n{mesh}\n'
            f"[regularization]\ncut_off_wavelength = {wavelength:g}\n[gauss_newton]\ntolerance = {TOLERANCE}")


def _render_beam(folder: Path, bits: int) -> None:
    paths = folder / "reference.tif", folder / "deformed.tif"
    write_pair(paths, Scene(SpeckleTexture(), FIELD), Picture(WIDTH, HEIGHT, Digitiser(bits)))


def _field_version() -> str:
    return hashlib.sha256(Path(__file__).with_name("paper_field.py").read_bytes()).hexdigest()


def make_once(folder: Path, arguments: dict[str, object], make: Callable[[], None]) -> None:
    """Make what a folder holds unless it was made with the same arguments."""
    stamp, wanted = folder / "arguments.json", json.dumps(arguments)
    if stamp.is_file() and stamp.read_text(encoding="utf-8") == wanted:
        return
    folder.mkdir(parents=True, exist_ok=True)
    stamp.unlink(missing_ok=True)
    make()
    stamp.write_text(wanted, encoding="utf-8")


def describe_tension(folder: Path, size: tuple[int, int] = (WIDTH, HEIGHT), *, paint_hole: bool = False) -> str:
    """Describe a plate with a hole in tension over the whole image: at full size 28 Mpx and 221,136 unknowns.

    The mesh covers the hole, which shows speckles, or is a dark disc without texture.
    """
    width, height = size
    hole = "--paint-hole" if paint_hole else "--no-paint-hole"
    made = images("kirsch", hole, "--size", f"{width}x{height}", folder=folder)
    # Conjugate gradients ask for texture everywhere.
    solver = "" if paint_hole else '[solver]\nmethod = "conjugate_gradient"\n'
    return (name_images(made / "reference.tif", made / "deformed.tif")
            + f"[mesh.structured]\nregion = {[MARGIN, MARGIN, width - MARGIN, height - MARGIN]}\n"
            f"element_size = {FULL_ELEMENT}\n[regularization]\ncut_off_wavelength = {FULL_WAVELENGTH}\n{solver}")


def name_images(reference: Path, deformed: Path) -> str:
    """The section of a case file that names a pair."""
    return f'[images]\nreference = "{reference}"\ndeformed = "{deformed}"\n'

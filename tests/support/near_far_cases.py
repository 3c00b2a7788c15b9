"""Case files on generated near-field and far-field pairs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ddic.images.camera import CameraMapping
from ddic.synth.fields import Affine, DisplacementField, Hole
from ddic.synth.near_far_scene import NearCamera, SetUpMotion, build_near_far_scene, build_near_mapping, write_near_far
from ddic.synth.render import Digitiser, Picture
from ddic.synth.speckle import two_scale_texture

RATIO = 4.0
WIDTH, HEIGHT = 240, 200
FOCUS = (150.0, 100.0)
ALPHA = (3.7, -2.2)
MOVED = SetUpMotion(ALPHA, 0.0, FOCUS)
# In equilibrium, and exact on any mesh.
STRETCHED = Affine(((0.004, 0.003), (-0.002, 0.006)), (0.4, -0.3), (120.0, 100.0))
NO_HOLE = Hole((-1000.0, -1000.0), 1.0)
SOLVER = "[solver]\nsubdomains = 5\n"
# Gauss-Newton to 1e-10, Krylov to 1e-12.
TIGHT = "[gauss_newton]\ntolerance = 1e-10\nrms_tolerance = 0.0\n"


@dataclass(frozen=True)
class NearField:
    """A near camera of 240 x 200 px; focus: specimen point in its middle; motion: of its set-up; tilt: as synth's."""

    focus: tuple[float, float] = FOCUS
    motion: SetUpMotion = MOVED
    tilt: tuple[float, float] = (0.0, 0.0)

    @property
    def mapping(self) -> CameraMapping:
        """phi."""
        return build_near_mapping(RATIO, self.focus, Picture(WIDTH, HEIGHT), tilt=self.tilt)

    @property
    def offset(self) -> list[float]:
        """Near pixel that shows the specimen's origin."""
        return [float(v) for v in self.mapping.homography[:2, 2]]


PLAIN = NearField()


def write_pairs(folder: Path, near: NearField = PLAIN, field: DisplacementField = STRETCHED, hole: Hole = NO_HOLE,
                noise: tuple[float, float] = (0.0, 0.0)) -> None:
    """Write the four images, grey levels not rounded; noise: of the far and of the near images, grey levels."""
    far, of_near = (Picture(WIDTH, HEIGHT, Digitiser(32, level, 3)) for level in noise)
    folder.mkdir(exist_ok=True)
    camera = NearCamera(near.mapping, near.motion, of_near)
    write_near_far(folder, build_near_far_scene(two_scale_texture(RATIO, 3), field, hole, far, camera))


def near_section(near: NearField = PLAIN, more: str = "", folder: str = "") -> str:
    """A [[near]] section; more: further lines of it; folder: of its images, with a slash."""
    mapping = more if "mapping_file" in more else f"ratio = {RATIO}\noffset = {near.offset}\n{more}"
    return (f'[[near]]\nreference = "{folder}near_reference.tif"\ndeformed = "{folder}near_deformed.tif"\n'
            f"{mapping}\n")


def case_text(*near: str, more: str = SOLVER, images: str = "", region: str = "region = [20, 20, 220, 180]",
              element: float = 10.0) -> str:
    """A case on these images; near: sections [[near]]; more: further sections; images: further lines of [images]."""
    return (f'[images]\nreference = "far_reference.tif"\ndeformed = "far_deformed.tif"\n{images}\n{"".join(near)}'
            f"[mesh.structured]\n{region}\nelement_size = {element}\n{more}")

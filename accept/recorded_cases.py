"""Small cases whose fields were recorded before a restructuring: images, case texts, what may differ.

Every run is converged far beyond what the fields are compared to, so that the comparison is about the fixed point of
Gauss-Newton and not about where an iteration stops. Nothing here imports ddic: images are those of ``ddic synth``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
import tifffile
from numpy.typing import NDArray

from bench.support.before import COMMIT

BOUND_PX = 1e-10
"""Largest difference of a displacement component from the recorded one, pixels."""

HIDDEN_BOUND_PX = 1e-8
"""The same where the deformed image hides pixels and eta is given: the fixed point does not depend on M, but M may be
that of all pixels or of the visible ones, and decides where the iteration ends."""

HIDDEN_CUT_OFF_BOUND_PX = 1e-3
"""The same where eta follows from M by a cut-off wavelength: 2.5 % of the pixels, as many as are hidden here, change
eta by as much and the field by 2.6e-4 px, which is below the tolerance of Gauss-Newton (|dq|/|q| <= 1e-3 by
default)."""

GREY = 128
"""Grey level of a part without texture."""

DEFAULTS_OF = "c99c72f"
"""Commit whose fields are recorded by defaults: what is excluded, corrected and spread over edges is chosen there."""

MASKS_KEPT_APART = "c7c6601"
"""Commit from which on what lies under a mask reaches no pixel that counts: fields beside masks were off by up to
3e-3 px before."""

CONVERGED = """
[gauss_newton]
tolerance = 1e-13
rms_tolerance = 1e-12
max_iterations = 2000
"""
"""Gauss-Newton to where rounding ends it: RMS dq of 1e-12 px. Where M counts pixels that are hidden it takes hundreds
of iterations, otherwise ten."""


@dataclass(frozen=True)
class Run:
    """One measurement of a recorded case.

    Attributes
    ----------
    name : str
        Name of the case file and of the result, unique in its case; later runs may start from it.
    text : str
        Case file, without ``[output]``.
    ranks : tuple of int
        Numbers of MPI ranks to run it on.
    bound : float
        Largest difference from the recorded field, pixels.
    """

    name: str
    text: str
    ranks: tuple[int, ...] = (1, 2)
    bound: float = BOUND_PX


@dataclass(frozen=True)
class RecordedCase:
    """A recorded case.

    Attributes
    ----------
    name : str
        Name of its folder.
    what : str
        What it covers.
    synth : tuple
        Arguments of ``ddic synth`` by the folder, below the case's own, that the images go to.
    runs : tuple of Run
        Measurements, in the order in which they are made.
    prepare : callable, optional
        Writes what else the runs read, or changes the images; called with the case's folder.
    commit : str
        Whose fields are recorded.
    """

    name: str
    what: str
    synth: tuple[tuple[str, str], ...]
    runs: tuple[Run, ...]
    prepare: Callable[[Path], None] | None = None
    commit: str = COMMIT


def images_section(folder: str = "images", more: str = "") -> str:
    """Give the section [images] of a pair of ``ddic synth``."""
    return f'[images]\nreference = "{folder}/reference.tif"\ndeformed = "{folder}/deformed.tif"\n{more}'


def mesh_section(region: tuple[float, float, float, float], size: float, more: str = "") -> str:
    """Give the section [mesh.structured].

    Parameters
    ----------
    region : tuple of float
        x0, y0, x1, y1, pixels.
    size : float
        Side of the elements, pixels.
    more : str
        Further lines of the section.

    Returns
    -------
    str
        TOML text.
    """
    return f"[mesh.structured]\nregion = {list(region)}\nelement_size = {size}\n{more}\n"


def gap_section(wavelength: float, more: str = "") -> str:
    """Give the section [regularization].

    Parameters
    ----------
    wavelength : float
        Cut-off wavelength, pixels.
    more : str
        Further lines of the section.

    Returns
    -------
    str
        TOML text.
    """
    return f"[regularization]\ncut_off_wavelength = {wavelength}\n{more}\n"


def solver_section(keys: str) -> str:
    """Give the section [solver], solved to 1e-12, and the tight [gauss_newton] that all runs share."""
    method = "" if "method" in keys else 'method = "dual"\n'
    return f"[solver]\n{method}tolerance = 1e-12\ninexact = false\n{keys}\n{CONVERGED}"


QUINTIC = "[correlation]\nspline_degree = 5\n"
NOTHING_BEYOND = 'not_controlled = ["left", "right", "top", "bottom"]'
HOLE = "circles = [{ center = [179.5, 179.5], radius = 40 }]"
NEAR_HOLE = "circles = [{ center = [119.5, 99.5], radius = 22 }]"
SQUARE = (20.0, 20.0, 236.0, 236.0)


def _translation() -> RecordedCase:
    mesh = mesh_section((24, 24, 232, 232), 16, 'cell = "T3"')
    text = images_section() + mesh + QUINTIC + solver_section('method = "monolithic"')
    return RecordedCase("translation", "one translation on one domain: T3, quintic spline, monolithic, the example",
                        (("images", "translation --vector 0.3 -0.2 --size 256x256 --seed 3"),),
                        (Run("result", text, (1,)),))


def _plate() -> RecordedCase:
    mesh = mesh_section((20, 20, 340, 340), 10, HOLE)
    text = images_section() + mesh + gap_section(60, NOTHING_BEYOND) + solver_section("subdomains = 8")
    return RecordedCase("plate", "plate with a hole, the demo made small: dual, 8 METIS subdomains, l_c = 60 px",
                        (("images", "kirsch --size 360x360 --strain 0.005 --radius 40 --noise 2 --seed 1"),),
                        (Run("result", text),))


def _beam() -> RecordedCase:
    mesh = '[mesh]\nfile = "beam.msh"\nmapping = { scale = 10, translation = [20, 25] }\n'
    text = (images_section(more='pixel_size = 0.1\nlength_unit = "mm"\n') + mesh + QUINTIC
            + gap_section(64, 'not_controlled = ["ends"]') + solver_section("subdomains = 6"))
    return RecordedCase("beam", "bent beam: mesh file with a named group and a mapping, dual, quintic spline, l_c = 64",
                        (("images", "bending --curvature 4e-5 --center 200 75 --size 400x150 --noise 2 --seed 5"),),
                        (Run("result", text),), _write_beam)


def _write_beam(folder: Path) -> None:
    """Write a beam of 36 x 10 mm in Q4 of 1 mm, whose two ends have a name."""
    n_x, n_y = 36, 10
    x, y = np.meshgrid(np.arange(n_x + 1.0), np.arange(n_y + 1.0))
    number = np.arange(x.size).reshape(x.shape)
    quads = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    ends = np.concatenate([np.column_stack([column[:-1], column[1:]]) for column in (number[:, 0], number[:, -1])])
    tags = [np.full(len(quads), 2), np.full(len(ends), 1)]
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    mesh = meshio.Mesh(points, [("quad", quads), ("line", ends)],
                       cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
                       field_data={"ends": np.array([1, 1]), "beam": np.array([2, 2])})
    meshio.write(folder / "beam.msh", mesh, file_format="gmsh22", binary=False)


def _restart() -> RecordedCase:
    coarse, fine = (mesh_section((24, 24, 216, 216), size) for size in (24, 12))
    solver = solver_section("subdomains = 4")
    first = images_section("first") + coarse + solver
    second = (images_section("second") + fine + solver
              + '[start]\nfrom_result = "first.vtkhdf"\nindependent = false\n')
    affine = "affine --size 240x240 --noise 1 --seed 4 --gradient"
    return RecordedCase("restart", "two frames, the second on a finer mesh from the result of the first",
                        (("first", f"{affine} 0.01 0 0 -0.003 --vector 4 -2"),
                         ("second", f"{affine} 0.014 0 0 -0.0042 --vector 5 -2.5")),
                        (Run("first", first), Run("second", second)))


def _near_images(name: str, ratio: float, offset: tuple[float, float], more: str = "") -> str:
    return (f'[[near]]\nreference = "{name}/near_reference.tif"\ndeformed = "{name}/near_deformed.tif"\n'
            f"ratio = {ratio}\noffset = {list(offset)}\nnoise = 1.5\n{more}\n")


def _far_images(folder: str) -> str:
    return (f'[images]\nreference = "{folder}/far_reference.tif"\ndeformed = "{folder}/far_deformed.tif"\n'
            "noise = 1.5\n")


NEAR_SIZE = "--size-far 240x200 --size-near 240x200 --ratio 4 --radius 22 --noise 1.5 --seed 2"


def _offset(center: tuple[float, float], ratio: float = 4.0, size: tuple[int, int] = (240, 200)) -> tuple[float, float]:
    """Find the near pixel that shows far pixel (0, 0), where the near picture's middle shows ``center``."""
    return ((size[0] - 1) / 2 - ratio * center[0], (size[1] - 1) / 2 - ratio * center[1])


def _near_far() -> RecordedCase:
    center = (145.0, 100.0)
    near = _near_images("images", 4, _offset(center), 'motion = "rigid"')
    text = (_far_images("images") + near + mesh_section((12, 12, 228, 188), 8, NEAR_HOLE) + QUINTIC
            + gap_section(40, NOTHING_BEYOND) + solver_section("subdomains = 5"))
    return RecordedCase("near_far", "far and near images, rigid motion of the near set-up, quintic spline, l_c = 40 px",
                        (("images", f"near-far {NEAR_SIZE} --near-center {center[0]} {center[1]} --alpha 1.7 -1.2"),),
                        (Run("result", text),))


def _two_near() -> RecordedCase:
    centers = {"right": (162.0, 100.0), "left": (66.0, 68.0)}
    boxes = {"right": (148, 84, 180, 116), "left": (52, 52, 84, 84)}
    synth = tuple((name, f"near-far {NEAR_SIZE} --near-center {x} {y} --alpha {alpha}")
                  for (name, (x, y)), alpha in zip(centers.items(), ("1.7 -1.2", "-0.8 0.9"), strict=True))
    mesh = mesh_section((12, 12, 228, 188), 8)
    shared, tied = ([_near_images(name, 4, _offset(center),
                                  mesh_section(boxes[name], 4).replace("[mesh.", "[near.mesh.") if own else "")
                     for name, center in centers.items()] for own in (False, True))
    rest = gap_section(40, NOTHING_BEYOND) + solver_section("subdomains = 6")
    return RecordedCase("two_near", "two near fields, on elements of the far mesh and on tied meshes of their own",
                        synth, (Run("shared", _far_images("right") + "".join(shared) + mesh + rest),
                                Run("tied", _far_images("right") + "".join(tied) + mesh + rest)))


def _masks() -> RecordedCase:
    keys = 'reference_mask = "mask.tif"\nexclude_saturated = true\n'
    # Elements wider than the mask's disk: without regularization each needs pixels of its own.
    text = images_section(more=keys) + mesh_section(SQUARE, 27) + solver_section("subdomains = 5")
    regularized = (images_section(more=keys) + mesh_section(SQUARE, 12) + gap_section(48)
                   + solver_section("subdomains = 5"))
    return RecordedCase("masks", "a mask of the reference image and a glare at the largest grey level",
                        (("images", "sinusoidal --size 256x256 --noise 1 --seed 7"),),
                        (Run("result", text), Run("regularized", regularized)), _write_mask, MASKS_KEPT_APART)


def _write_mask(folder: Path) -> None:
    """Mask a disk and let a patch of the reference image glare; nothing else is as bright."""
    y, x = np.mgrid[0:256, 0:256]
    disk = (x - 90) ** 2 + (y - 150) ** 2 < 14**2
    tifffile.imwrite(folder / "mask.tif", np.where(disk, 0, 255).astype(np.uint8))
    for name in ("reference", "deformed"):
        path = folder / "images" / f"{name}.tif"
        image = np.minimum(tifffile.imread(path), 254)
        if name == "reference":
            image[60:75, 170:190] = 255
        tifffile.imwrite(path, image)


def _grey() -> RecordedCase:
    def text(kind: str) -> str:
        correlation = f'[correlation]\ngrey_correction = "{kind}"\n'
        return images_section() + mesh_section(SQUARE, 18) + correlation + solver_section("subdomains = 4")

    return RecordedCase("grey", "grey levels corrected for the whole image and by element",
                        (("images", "sinusoidal --size 256x256 --noise 1 --seed 8"),),
                        (Run("global", text("global")), Run("element", text("element"))), _dim)


def _dim(folder: Path) -> None:
    """Give the deformed image less contrast, and more light on one side."""
    path = folder / "images" / "deformed.tif"
    image = tifffile.imread(path).astype(float)
    light = np.linspace(0, 20, image.shape[1])
    tifffile.imwrite(path, np.clip(np.round(0.8 * image + 15 + light), 0, 255).astype(np.uint8))


def _methods() -> RecordedCase:
    def text(method: str) -> str:
        return images_section() + mesh_section(SQUARE, 12) + gap_section(48) + solver_section(f'method = "{method}"')

    return RecordedCase("methods", "the methods that join subdomains otherwise than the dual one",
                        (("images", "sinusoidal --size 256x256 --noise 2 --seed 9"),),
                        (Run("assembled", text("assembled")), Run("conjugate_gradient", text("conjugate_gradient")),
                         Run("monolithic", text("monolithic"), (1,))))


def _interface() -> RecordedCase:
    mesh, triangles = mesh_section(SQUARE, 12), mesh_section(SQUARE, 12, 'cell = "T3"')
    paper = solver_section('subdomains = 6\nweighting = "paper"\npreconditioner = "paper"')
    blocks = 'partition = "blocks"\nblocks = [3, 3]\n'
    two_level, scaled = (solver_section(f'{blocks}preconditioner = "{kind}"') for kind in ("two_level", "scaled"))
    return RecordedCase(
        "interface", "the paper's weighting with a quintic spline; T3 in 3 x 3 blocks with and without regularization",
        (("images", "sinusoidal --size 256x256 --noise 2 --seed 10"),),
        (Run("paper", images_section() + mesh + QUINTIC + gap_section(60) + paper),
         Run("blocks", images_section() + triangles + gap_section(60) + two_level),
         Run("texture_only", images_section() + triangles + scaled)))


def _blank() -> RecordedCase:
    keys = 'partition = "blocks"\nblocks = [3, 3]'
    text = images_section() + mesh_section(SQUARE, 12) + gap_section(48) + solver_section(keys)
    return RecordedCase("blank", "a subdomain without texture, held by mechanics and its neighbours",
                        (("images", "sinusoidal --size 256x256 --noise 1 --seed 12"),), (Run("result", text),), _wipe)


def _wipe(folder: Path) -> None:
    """Take the texture off the middle block and an element around it, in both images."""
    for name in ("reference", "deformed"):
        path = folder / "images" / f"{name}.tif"
        image: NDArray[np.uint8] = tifffile.imread(path)
        image[80:176, 80:176] = GREY
        tifffile.imwrite(path, image)


def _hidden() -> RecordedCase:
    # Half a pixel from a whole number: no pixel is near the edge, whether at the start or at the end.
    mesh, solver = mesh_section((8, 8, 248, 248), 12), solver_section("subdomains = 6")
    eta = "[regularization]\neta = 150000.0\n"
    return RecordedCase("hidden", "a shift that takes pixels out of the deformed image",
                        (("images", "translation --vector 13.5 -0.3 --size 256x256 --noise 1 --seed 13"),),
                        (Run("result", images_section() + mesh + eta + solver, bound=HIDDEN_BOUND_PX),
                         Run("cut_off", images_section() + mesh + gap_section(60) + solver,
                             bound=HIDDEN_CUT_OFF_BOUND_PX)))


def _hidden_mask() -> RecordedCase:
    mesh, solver = mesh_section((8, 8, 248, 248), 12), solver_section("subdomains = 6")
    eta = "[regularization]\neta = 150000.0\n"
    text = images_section(more='deformed_mask = "mask.tif"\n') + mesh + eta + solver
    return RecordedCase("hidden_mask", "the same with a mask of the deformed image",
                        (("images", "translation --vector 13.5 -0.3 --size 256x256 --noise 1 --seed 13"),),
                        (Run("result", text, bound=HIDDEN_BOUND_PX),), _mask_deformed, MASKS_KEPT_APART)


def _mask_deformed(folder: Path) -> None:
    """Hide a box of the deformed image."""
    mask = np.full((256, 256), 255, np.uint8)
    mask[100:130, 60:100] = 0
    tifffile.imwrite(folder / "mask.tif", mask)


CASES = {case.name: case for case in (
    _translation(), _plate(), _beam(), _restart(), _near_far(), _two_near(), _masks(), _grey(), _methods(),
    _interface(), _blank(), _hidden(), _hidden_mask())}
"""All recorded cases by name."""

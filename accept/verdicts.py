"""The verdict that ends a run, on pairs of which it is known whether their field can be trusted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import meshio
import numpy as np
from numpy.typing import NDArray

import ddic
from accept.spoilt_images import BLURRED, BRIGHTNESS, ELEMENT, HIDDEN, HOPELESS, OTHERS, REGION, SIDE, draw_clean
from accept.support.deformed_pair import Camera, make_linear, make_rotation, render_deformed
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import real_data
from ddic.io.result_schema import DISTRUST, LOOK, TRUST
from ddic.synth.speckle import SpeckleTexture

Image = NDArray[np.uint8]
Pair = tuple[Image, Image]

FEWEST_RIGHT = 38
"""Of 40."""

WAVELENGTH = 80.0
"""Cut-off wavelength of every second case, pixels."""

BACKGROUND = 5.0
"""Grey level behind the specimen."""

NOISE = 2.0
"""Standard deviation, grey levels."""


@dataclass(frozen=True)
class Trial:
    """A pair whose verdict is known.

    Attributes
    ----------
    name : str
        What it shows.
    draw : callable
        Gives the images.
    right : frozenset of str
        Verdicts that are right.
    mesh : callable
        Gives the mesh.
    """

    name: str
    draw: Callable[[], Pair]
    right: frozenset[str]
    mesh: Callable[[], Any] = lambda: ddic.structured_mesh(REGION, ELEMENT)


def measure_verdicts(scale: Scale) -> list[Row]:
    """Measure the verdict on all pairs, by turns without regularization and with."""
    trials = list_trials()
    chosen = trials[:1] + trials[-1:] if scale.smoke else trials
    wrong: list[str] = []
    trusted: list[str] = []
    for number, trial in enumerate(chosen):
        wavelength = WAVELENGTH if number % 2 else None
        word = _find_verdict(trial, wavelength)
        if word in trial.right:
            continue
        of_case = f"{trial.name}, l_c {wavelength or 'none'}: {word}, not {' or '.join(sorted(trial.right))}"
        (trusted if word == TRUST else wrong).append(of_case)
    n_right = len(chosen) - len(wrong) - len(trusted)
    return [Row(f"verdicts on {len(chosen)} pairs: good, on a black background, swapped axes, failed specimens, "
                f"unrelated, blurred, other light, hidden; Q4 of {ELEMENT} px, by turns without l_c and with "
                f"{WAVELENGTH:g} px", f"right in {FEWEST_RIGHT} of 40; never trust in a wrong one",
                f"right in {n_right} of {len(chosen)}; {'; '.join([*trusted, *wrong]) or 'none wrong'}",
                n_right >= len(chosen) - (40 - FEWEST_RIGHT) and not trusted)]


def _find_verdict(trial: Trial, wavelength: float | None) -> str:
    """The word of the verdict; that of the last field where it does not converge or is refused."""
    regularization = None if wavelength is None else {"cut_off_wavelength": wavelength}
    try:
        result = ddic.measure(trial.draw(), trial.mesh(), regularization=regularization)
    except ddic.DdicError:
        return DISTRUST
    return "none" if result.verdict is None else result.verdict.word


def list_trials() -> list[Trial]:
    """List 40 pairs."""
    good, doubtful, lost = frozenset({TRUST}), frozenset({LOOK}), frozenset({DISTRUST})
    not_trusted = doubtful | lost
    return [
        *(Trial(f"noise of {noise} grey levels", partial(_draw, noise=noise), good) for noise in (0, 2, 5)),
        Trial("speckles twice as large", partial(_draw, speckle=2.0), good),
        Trial("10 degrees", partial(_draw, gradient=make_rotation(10.0)), good),
        Trial("strain of 10 %", partial(_draw, gradient=np.diag([0.1, -0.03])), good),
        Trial("contrast inverted", lambda: _change(lambda g: 255 - g), good),
        *(Trial(name, partial(_take, BRIGHTNESS[name]), good)
          for name in ("brightness x 0.9 + 5", "brightness x 0.6 + 20", "brightness + 60, clipped",
                       "a ramp of brightness")),
        Trial("a reflection, clipped", partial(_take, BRIGHTNESS["a reflection, clipped"]), doubtful),
        *(Trial(name, partial(_take, HIDDEN[name]), doubtful) for name in HIDDEN),
        Trial("dirt on the lens", partial(_take, OTHERS["dirt on the lens"]), doubtful),
        *(Trial(f"{pixels} px out of the image", partial(_take, OTHERS[f"{pixels} px out of the image"]), doubtful)
          for pixels in (60, 120)),
        Trial("motion blur of 5 px", partial(_take, BLURRED["motion blur of 5 px"]), good),
        Trial(HOPELESS, partial(_take, BLURRED[HOPELESS]), lost),
        Trial("the same image twice", lambda: (draw_clean().reference,) * 2, doubtful),
        *(Trial(f"specimen of {width} px on black", partial(_draw_on_black, width), verdict)
          for width, verdict in ((120, lost), (200, lost), (420, doubtful), (500, doubtful))),
        Trial("all black", lambda: (_draw_black(1), _draw_black(2)), lost),
        Trial("deformed image black", lambda: (draw_clean().reference, _draw_black(1)), lost),
        Trial("another specimen", lambda: (draw_clean().reference, _draw(seed=99)[1]), lost),
        Trial("rows and columns swapped", lambda: _change(np.transpose), lost),
        Trial("rows upside down", lambda: _change(np.flipud), lost),
        *(Trial(f"torn apart by {opening} px", partial(_tear, float(opening)), verdict)
          for opening, verdict in ((1, not_trusted), (3, lost), (10, lost), (40, lost))),
        Trial("stripes", _draw_stripes, lost),
        Trial("openhole 53 and 70", partial(_read_openhole, 70), good, _read_openhole_mesh),
        Trial("openhole 53 and 78, failed", partial(_read_openhole, 78), lost, _read_openhole_mesh),
    ]


def _draw(noise: float = NOISE, speckle: float = 1.0, gradient: NDArray[np.float64] | None = None,
          seed: int = 3) -> Pair:
    """A homogeneous deformation, by default small."""
    small = make_rotation(1.0) + np.diag([0.004, -0.002])
    deformation = make_linear(small if gradient is None else gradient, np.full(2, SIDE / 2), np.array([5.3, -7.2]))
    return render_deformed(deformation, Camera((SIDE, SIDE), noise=noise, speckle=speckle, seed=seed))


def _take(draw: Callable[[], Any]) -> Pair:
    pair = draw()
    return pair.reference, pair.deformed


def _change(how: Callable[[Image], Any]) -> Pair:
    clean = draw_clean()
    return clean.reference, np.ascontiguousarray(how(clean.deformed))


def _digitise(levels: NDArray[np.float64], seed: int) -> Image:
    noise = NOISE * np.random.default_rng(seed).standard_normal(levels.shape)
    return np.asarray(np.clip(np.rint(levels + noise), 0, 255), np.uint8)


def _draw_black(seed: int) -> Image:
    return _digitise(np.full((SIDE, SIDE), BACKGROUND), seed)


def _draw_on_black(width: int) -> Pair:
    """The specimen fills the first columns alone; the region reaches beyond it."""
    clean = draw_clean()
    reference, deformed = clean.reference.copy(), clean.deformed.copy()
    reference[:, width:], deformed[:, width + 5:] = _draw_black(1)[:, width:], _draw_black(2)[:, width + 5:]
    return reference, deformed


def _tear(opening: float) -> Pair:
    """The upper half moves up and the lower one down by half the opening; black shows between them."""
    y, x = np.mgrid[0:SIDE, 0:SIDE].astype(float)
    texture = SpeckleTexture(3)
    middle, half = SIDE / 2, opening / 2
    is_above, is_below = y < middle - half, y > middle + half
    torn = 255.0 * texture.grey(x, y + half * (is_above * 1.0 - is_below))
    torn[~is_above & ~is_below] = BACKGROUND
    return _digitise(255.0 * texture.grey(x, y), 1), _digitise(torn, 2)


def _draw_stripes() -> Pair:
    """A pattern that repeats itself."""
    y, x = np.mgrid[0:SIDE, 0:SIDE].astype(float)
    reference, deformed = (128.0 + 80.0 * np.sin(2 * np.pi * (x - shift) / 12) * np.sin(2 * np.pi * (y - shift) / 12)
                           for shift in (0.0, 5.0))
    return _digitise(reference, 1), _digitise(deformed, 2)


def _read_openhole(number: int) -> Pair:
    folder = real_data() / "openhole"
    reference, deformed = (cv2.imread(str(folder / f"zoom-{frame:04d}_1.tif"), cv2.IMREAD_UNCHANGED)
                           for frame in (53, number))
    return np.asarray(reference), np.asarray(deformed)


def _read_openhole_mesh() -> Any:
    return meshio.read(real_data() / "openhole" / "mesh_q4_pixels.msh")

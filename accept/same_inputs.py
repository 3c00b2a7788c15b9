"""The same inputs given in Python, to ``ddic check`` and to ``ddic run``: what is kept, refused and told of them."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import ddic
from accept.support.ended_job import DDIC, Job
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import environment

Image = NDArray[np.uint8]

SIDE, MASKED = 240, 60
"""Sides of the images and of the square in their middle that is masked, pixels."""

SIDES_LEFT = (4, 0, 9)
"""Sides of the squares that masks leave, of which there is nothing to measure by, pixels."""

SAME_PX = 1e-9
"""Largest difference between fields of the same inputs, pixels."""

NO_NAMES: tuple[Any, ...] = (None, 7, 0.5, b"case.toml", ["case.toml"], {})
"""What Python may give in place of a file's name."""

REGION = (20, 20, 220, 220)

CASE = ('[images]\nreference = "f.tif"\ndeformed = "g.tif"\n{}[mesh.structured]\n'
        f"region = {list(REGION)}\nelement_size = {{}}\n")


def measure_same_inputs(scale: Scale) -> list[Row]:
    """Measure what is written into after ``ddic.prepare``, masks, cases that cannot be run, and names that are none.

    Parameters
    ----------
    scale : Scale
        A smoke run tries one size of masks.

    Returns
    -------
    list of Row
        One each.
    """
    folder = scale.folder("same_inputs")
    folder.mkdir(parents=True, exist_ok=True)
    pair = ddic.make_synthetic_pair(_move, (SIDE, SIDE), noise=1.0, seed=4)
    for name, image in zip("fg", pair, strict=True):
        cv2.imwrite(str(folder / f"{name}.tif"), image)
    sides = SIDES_LEFT[:1] if scale.smoke else SIDES_LEFT
    return [_write_after_prepare(*pair), _mask_everywhere(folder, *pair), _check_as_run(folder, sides),
            _start_ranks(folder), _open_no_file()]


def _move(points: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y = points.T
    return np.column_stack([1.3 + 0.002 * x, -0.7 - 0.001 * y])


def _write_after_prepare(reference: Image, deformed: Image) -> Row:
    mesh, given = ddic.structured_mesh(REGION, 10), reference.copy()
    before = ddic.measure((reference, deformed), mesh).displacement
    with ddic.prepare(given, mesh) as session:
        given[:] = 0
        difference = float(np.abs(session.measure(deformed).displacement - before).max())
    return Row("the array of a reference image set to 0 after ddic.prepare: the next field",
               f"the same to {SAME_PX} px", f"{difference:.1e} px", difference <= SAME_PX)


def _mask_everywhere(folder: Path, reference: Image, deformed: Image) -> Row:
    """A mask wider than elements, without regularization, as an array, a masked array and a file."""
    mesh, low = ddic.structured_mesh(REGION, 10), (SIDE - MASKED) // 2
    mask = np.full(reference.shape, 255, np.uint8)
    mask[low:low + MASKED, low:low + MASKED] = 0
    cv2.imwrite(str(folder / "mask.tif"), mask)
    path = folder / "masked.toml"
    path.write_text(CASE.format('reference_mask = "mask.tif"\n', 10), encoding="utf-8")
    code, lines = _end(0, folder, "run", path.name)
    if code != 0:
        return Row("a mask without regularization", "measured", f"ddic run ends with {code}: {lines}", False)
    by_run = ddic.open(folder / "result.vtkhdf").displacement
    masked: Any = np.ma.masked_array(reference, mask=mask == 0)  # type: ignore[no-untyped-call]  # numpy 1.26
    fields = {"ddic.Image": ddic.measure((ddic.Image(reference, mask=mask), deformed), mesh),
              "a masked array": ddic.measure((masked, deformed), mesh),
              "the case in Python": ddic.measure(path)}
    off = {name: float(np.nanmax(np.abs(field.displacement - by_run))) for name, field in fields.items()}
    n_nan = {int(np.isnan(field.displacement).any(axis=1).sum()) for field in fields.values()}
    same_nan = n_nan == {int(np.isnan(by_run).any(axis=1).sum())}
    return Row(f"a mask of {MASKED} x {MASKED} px on 10-px elements, without regularization, beside ddic run: largest "
               "difference", f"<= {SAME_PX} px, the same nodes nan",
               f"{', '.join(f'{name} {value:.1e} px' for name, value in off.items())}; nan: {n_nan}",
               max(off.values()) <= SAME_PX and same_nan)


def _check_as_run(folder: Path, sides: Sequence[int]) -> Row:
    """Masks that leave next to nothing, of either image."""
    wrong = []
    for side in sides:
        for key in ("reference_mask", "deformed_mask"):
            mask = np.zeros((SIDE, SIDE), np.uint8)
            mask[100:100 + side, 100:100 + side] = 255
            cv2.imwrite(str(folder / "little.tif"), mask)
            (folder / "little.toml").write_text(CASE.format(f'{key} = "little.tif"\n', 10), encoding="utf-8")
            said = [_end(0, folder, command, "little.toml") for command in ("check", "run")]
            if said[0] != said[1] or said[0][0] != 2 or len(said[0][1]) != 1:
                wrong.append(f"{key}, {side} px: {said}")
    left = ", ".join(str(side**2) for side in sides)
    return Row(f"masks of the reference image and of the deformed one that leave {left} px: ddic check and ddic run",
               "both end with 2 and the same line", f"{len(wrong)} do not{'; '.join(['', *wrong[:2]])}", not wrong)


def _start_ranks(folder: Path) -> Row:
    """More ranks than cells."""
    (folder / "few.toml").write_text(CASE.format("", 100), encoding="utf-8")
    told = subprocess.run([*DDIC, "check", "few.toml"], cwd=folder, env=environment(), text=True, capture_output=True,
                          check=False).stdout
    most = [line.split(maxsplit=2)[2] for line in told.splitlines() if line.startswith("MPI ranks")]
    four, six = _end(4, folder, "run", "few.toml"), _end(6, folder, "run", "few.toml")
    is_right = (most == ["4 at most"] and four[0] == 0 and six[0] == 2 and len(six[1]) == 1
                and "start at most 4 ranks or use smaller elements" in six[1][0] and "solver." not in six[1][0])
    return Row("4 cells without [solver]: ddic check, ddic run on 4 and 6 ranks",
               "check says 4 ranks at most; measured; one line, exit code 2, no key that the case does not have",
               f"check says {most}; exit codes {four[0]} and {six[0]}: {six[1]}", is_right)


def _open_no_file() -> Row:
    """What is no name of a file, given to whatever opens one."""
    wrong = []
    openers: dict[str, Callable[[Any], object]] = {"load_case": ddic.load_case, "load_probes": ddic.load_probes,
                                                   "open": ddic.open}
    for name, given in product(openers, NO_NAMES):
        try:
            openers[name](given)
            wrong.append(f"{name}({given!r}) is taken")
        except ddic.InputError as error:
            if len(str(error).splitlines()) != 1:
                wrong.append(f"{name}({given!r}): {error}")
        except Exception as error:
            wrong.append(f"{name}({given!r}): {type(error).__name__}: {error}")
    named = ", ".join(f"ddic.{name}" for name in openers)
    return Row(f"{', '.join(map(repr, NO_NAMES))} in place of a file: {named}",
               "InputError of one line", f"{len(wrong)} are not so{'; '.join(['', *wrong[:3]])}", not wrong)


def _end(n_ranks: int, folder: Path, *words: str) -> tuple[int, list[str]]:
    """Exit code of a command, and its lines on standard error."""
    with Job(n_ranks, [*DDIC, *words], folder) as job:
        ended = job.wait()
    return ended.code, ended.lines

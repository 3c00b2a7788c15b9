"""Commands asked to write over their inputs, and the same inputs in Python, ``ddic check`` and ``ddic run``."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import cv2
import meshio
import numpy as np
from click.testing import CliRunner
from numpy.typing import NDArray

import ddic
from accept.support.ended_job import DDIC, Job
from accept.table import Scale
from bench.support import runs
from bench.support.rows import Row
from bench.support.runs import ddic_command, environment, images
from ddic.cli.app import command_line

NULL, FULL = 3, 7
"""Numbers of devices of memory: the one that takes all, and the one that is full."""


def make_device(path: Path, number: int = NULL) -> None:
    """Make a device; a pipe where this user may have none."""
    try:
        os.mknod(path, 0o666 | stat.S_IFCHR, os.makedev(1, number))
    except OSError:
        os.mkfifo(path)


INPUTS = ("far_reference.tif", "far_deformed.tif", "near_reference.tif", "near_deformed.tif", "truth.json", "mask.png",
          "mesh.msh", "mapping.toml", "partition.txt", "points.csv", "case.toml", "result.vtkhdf", "device", "pipe")
WAYS = ("name", "hard link", "symbolic link")
LONGEST_RUN = 60.0
"""Seconds that ``ddic run`` may take to refuse."""

_CASE = """[images]
reference = "far_reference.tif"
deformed = "far_deformed.tif"
reference_mask = "mask.png"
[mesh]
file = "mesh.msh"
[solver]
method = "dual"
partition = "file"
partition_file = "partition.txt"
[start]
from_points = "points.csv"
[[near]]
reference = "near_reference.tif"
deformed = "near_deformed.tif"
mapping_file = "mapping.toml"
"""


@dataclass(frozen=True)
class Writer:
    """A command that writes.

    Attributes
    ----------
    name : str
        Of ``ddic``.
    words : tuple of str
        Its arguments; OUT is the output, PLACE its folder.
    fixed_name : str or None
        Of the output in that folder, where the command names it; None where the user does.
    """

    name: str
    words: tuple[str, ...]
    fixed_name: str | None = None


WRITERS = (
    Writer("calibrate", ("far_reference.tif", "near_reference.tif", "--ratio", "4", "--output", "OUT")),
    Writer("opening", ("result.vtkhdf", "--output", "OUT")),
    Writer("report", ("result.vtkhdf", "--output", "OUT")),
    Writer("probe", ("result.vtkhdf", "--point", "60,60", "--csv", "OUT")),
    Writer("export", ("result.vtkhdf", "--csv", "PLACE/table.csv"), "table.nodes.csv"),
    Writer("check", ("case.toml", "--plot", "OUT")),
    Writer("mesh", ("case.toml", "--output", "OUT")),
    Writer("plot", ("result.vtkhdf", "--kind", "deformed", "--output", "PLACE"), "result.deformed.png"),
    Writer("sweep", ("case.toml", "--output", "PLACE"), "case.sweep.csv"),
    Writer("sweep", ("case.toml", "--output", "PLACE"), "case.sweep.png"),
    Writer("uncertainty", ("case.toml", "--output", "PLACE"), "case.uncertainty.csv"),
    Writer("uncertainty", ("case.toml", "--output", "PLACE"), "case.uncertainty.png"),
    Writer("synth", ("translation", "--size", "64x64", "--output", "PLACE"), "reference.tif"),
    Writer("synth", ("translation", "--size", "64x64", "--output", "PLACE"), "truth.json"),
    Writer("synth", ("near-far", "--output", "PLACE"), "near_reference.tif"),
    Writer("run", ("run.toml",), None),
)


def measure_outputs_onto_inputs(scale: Scale) -> list[Row]:
    """Ask every command to write over every input."""
    folder = scale.folder("outputs_onto_inputs")
    shutil.rmtree(folder, ignore_errors=True)
    _prepare(folder)
    wrong, n_trials = [], 0
    for writer in WRITERS:
        for input_ in INPUTS:
            for way in WAYS[:1] if scale.smoke else WAYS:
                for said in _try(folder, writer, input_, way):
                    n_trials += 1
                    if said:
                        wrong.append(f"{writer.name} onto {input_} by {way}: {said}")
    found = f"{n_trials - len(wrong)} of {n_trials} so" + (f"; {'; '.join(wrong[:8])}" if wrong else "")
    return [Row(f"{len({writer.name for writer in WRITERS})} commands onto {len(INPUTS)} inputs and devices by "
                f"{', '.join(WAYS)}", "refused: exit code 2, one line, every input intact, nothing new", found,
                not wrong)]


def _prepare(folder: Path) -> None:
    """A case with every kind of input, and a result."""
    images("near-far", "--size", "200x160", "--ratio", "4", "--radius", "20", "--seed", "2", folder=folder)
    cv2.imwrite(str(folder / "mask.png"), np.full((160, 200), 255, np.uint8))
    (folder / "mapping.toml").write_text("# Near camera: homography\nhomography = [[4, 0, 0], [0, 4, 0], [0, 0, 1]]\n",
                                         encoding="utf-8")
    corners = np.array([[40.0, 40.0, 0.0], [160.0, 40.0, 0.0], [160.0, 120.0, 0.0], [40.0, 120.0, 0.0]])
    meshio.write(folder / "mesh.msh", meshio.Mesh(corners, [("quad", np.array([[0, 1, 2, 3]]))]), file_format="gmsh")
    os.mkfifo(folder / "pipe")
    make_device(folder / "device")
    (folder / "partition.txt").write_text("0\n", encoding="utf-8")
    (folder / "points.csv").write_text("x,y,u,v\n40,40,0,0\n", encoding="utf-8")
    simple = ('[images]\nreference = "far_reference.tif"\ndeformed = "far_deformed.tif"\n[mesh.structured]\n'
              "region = [20, 20, 180, 140]\nelement_size = 20\n")
    (folder / "simple.toml").write_text(f'{simple}[output]\nfile = "result.vtkhdf"\n', encoding="utf-8")
    runs.ddic("run", str(folder / "simple.toml"))
    (folder / "simple.toml").unlink()
    (folder / "result.json").unlink()
    (folder / "case.toml").write_text(_CASE, encoding="utf-8")


def _try(folder: Path, writer: Writer, input_: str, way: str) -> Iterator[str]:
    """Ask a command; what is wrong with its answer, empty where nothing is."""
    target = folder / input_
    place = folder / "place"
    place.mkdir()
    (folder / "run.toml").touch()
    if writer.name == "run" and input_ == "case.toml":
        target = folder / "run.toml"
    if writer.fixed_name is not None or way != "name":
        # Where the command names its output, that is a link to the input.
        output = place / (writer.fixed_name or f"linked{target.suffix}")
        if writer.name == "check":
            output = output.with_suffix(".png")
        if way == "symbolic link":
            output.symlink_to(target)
        else:
            output.hardlink_to(target)
    else:
        output = target
    case = _CASE.replace('from_points = "points.csv"', f'from_result = "{input_}"') if _is_result(input_) else _CASE
    (folder / "run.toml").write_text(f'{case}[output]\nfile = "{output}"\n', encoding="utf-8")
    before = _read(folder)
    words = [word.replace("OUT", str(output)).replace("PLACE", str(place)) for word in writer.words]
    words = [str(folder / word) if (folder / word).is_file() else word for word in words]
    code, lines = _ask(writer.name, words)
    # The case is not otherwise fit to be run: of its problems the output must be one.
    about = [line for line in lines if str(output) in line or f"--plot {output}" in line or str(target) in line]
    wrong = [] if code == 2 else [f"exit code {code}: {lines[-1:]}"]
    if len(about) != 1 or (len(lines) != 1 and writer.name != "run"):
        wrong.append(f"{len(lines)} lines: {lines[:2]}")
    if _read(folder) != before:
        wrong.append("something was written")
    shutil.rmtree(place)
    (folder / "run.toml").unlink()
    yield "; ".join(wrong)


def _ask(name: str, words: Sequence[str]) -> tuple[int, list[str]]:
    """Exit code of a command, and its lines on standard error; a run, which starts MPI, is a process of its own."""
    if name != "run":
        done = CliRunner().invoke(command_line, [name, *words])
        raised = [] if done.exception is None or isinstance(done.exception, SystemExit) else [repr(done.exception)]
        return done.exit_code, [*done.stderr.strip().splitlines(), *raised]
    run = subprocess.run([ddic_command(), "run", *words], env=environment(), capture_output=True, text=True,
                         timeout=LONGEST_RUN, check=False)
    return run.returncode, run.stderr.strip().splitlines()


def _is_result(input_: str) -> bool:
    """Whether a file is an input of a case that starts from it, instead of from points."""
    return input_.endswith(".vtkhdf")


def _read(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


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
    """Measure what is written into after ``ddic.prepare``, masks, cases that cannot be run, and names that are none."""
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

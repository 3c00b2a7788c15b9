"""Every command asked to write over every input of a case, by its name and through links."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import meshio
import numpy as np
from click.testing import CliRunner

from accept.support.own_device import make_device
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ddic, ddic_command, environment, images
from ddic.cli.app import command_line

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
    """Ask every command to write over every input.

    Parameters
    ----------
    scale : Scale
        A smoke run asks them by name alone.

    Returns
    -------
    list of Row
        One.
    """
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
    ddic("run", str(folder / "simple.toml"))
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

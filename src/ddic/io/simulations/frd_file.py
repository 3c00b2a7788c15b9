"""CalculiX's result files, .frd in ASCII: the mesh, and the displacement of each step."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ddic.arrays import Array
from ddic.errors import InputError

CELLS = {1: "hexahedron", 3: "tetra", 4: "hexahedron20", 6: "tetra10", 7: "triangle", 8: "triangle6", 9: "quad",
         10: "quad8"}
"""meshio's names of the cells, by their numbers in the file."""

SIDES_BETWEEN_FACES_FIRST = (*range(12), *range(16, 20), *range(12, 16))
"""Nodes of a hexahedron of twenty, whose sides between the two faces come before those of the second one, in the order
of VTK, where they come last."""

DISPLACEMENT = "DISP"
"""What the file calls a displacement."""


@dataclass(frozen=True)
class FrdStep:
    """Where a displacement is in a file.

    Attributes
    ----------
    time : float
        Of the step; of a frequency its value.
    name : str
        Step and increment, as the file counts them.
    line : int
        Number of the line that names the field, from 0.
    is_long : bool
        Whether numbers of nodes take ten digits, not five.
    """

    time: float
    name: str
    line: int
    is_long: bool


def list_frd_steps(path: Path) -> list[FrdStep]:
    """List the steps of which a file holds the displacement; raises InputError where it is not ASCII."""
    steps, header, step = [], "", ""
    for number, line in enumerate(_read_lines(path)):
        if line.startswith("    1PSTEP"):
            step = ".".join(line[10:].split()[1:3][::-1])
        elif line.startswith("  100C"):
            header = line
        elif line.startswith(" -4") and line[5:13].strip() == DISPLACEMENT and header:
            name = f"step {step or header[58:63].strip()}"
            steps.append(FrdStep(float(header[12:24]), name, number, _is_long(path, header)))
    return steps


def read_frd_step(path: Path, step: FrdStep) -> Any:
    """Read the mesh and the displacement of a step, as a mesh of meshio."""
    from meshio import Mesh as RawMesh

    numbers, points, blocks = _read_mesh(path)
    places = {node: place for place, node in enumerate(numbers)}
    u = np.full((len(points), 3), np.nan)
    for node, values in _read_records(_read_lines(path)[step.line + 1:], is_long=step.is_long):
        u[places[node]] = values[:3]
    cells = [(kind, np.array([[places[node] for node in cell] for cell in of_kind]))
             for kind, of_kind in blocks.items()]
    return RawMesh(points, cells, {"displacement": u})


def _read_mesh(path: Path) -> tuple[list[int], Array, dict[str, list[list[int]]]]:
    """Numbers and places of nodes, (n, 3), and nodes of cells by their kind."""
    numbers: list[int] = []
    points: list[list[float]] = []
    blocks: dict[str, list[list[int]]] = {}
    lines = _read_lines(path)
    for place, line in enumerate(lines):
        if line.startswith("    2C"):
            for node, values in _read_records(lines[place + 1:], is_long=_is_long(path, line)):
                numbers.append(node)
                points.append(values[:3])
        elif line.startswith("    3C"):
            for kind, nodes in _read_cells(path, lines[place + 1:], is_long=_is_long(path, line)):
                blocks.setdefault(kind, []).append(nodes)
    for nodes in blocks.get("hexahedron20", []):
        nodes[:] = [nodes[k] for k in SIDES_BETWEEN_FACES_FIRST]
    return numbers, np.array(points), blocks


NUMBER = re.compile(r"[-+]?\d\.\d+E[-+]\d+|[-+]?nan|[-+]?inf", re.IGNORECASE)
"""A number of a record: they stand close to each other, and are one digit longer where Windows has written them."""


def _read_records(lines: list[str], *, is_long: bool) -> Iterator[tuple[int, list[float]]]:
    """Node and numbers of each record, up to the end of a block."""
    first = 13 if is_long else 8
    for line in lines:
        if line.startswith(" -3"):
            return
        if line.startswith(" -1"):
            yield int(line[3:first]), [float(text) for text in NUMBER.findall(line[first:])]


def _read_cells(path: Path, lines: list[str], *, is_long: bool) -> Iterator[tuple[str, list[int]]]:
    """Kind and nodes of each cell, up to the end of a block."""
    width = 10 if is_long else 5
    kind, nodes = "", list[int]()
    for line in lines:
        if line.startswith((" -1", " -3")) and kind:
            yield kind, nodes
        if line.startswith(" -3"):
            return
        if line.startswith(" -1"):
            number, nodes = int(line[3 + width:8 + width]), []
            if number not in CELLS:
                raise InputError(f"{path}: holds cells of CalculiX's type {number}; known are plane ones, tetrahedra "
                                 "and hexahedra: export these alone")
            kind = CELLS[number]
        else:
            text = line[3:].rstrip()
            nodes += [int(text[k:k + width]) for k in range(0, len(text) - width + 1, width)]


def _is_long(path: Path, header: str) -> bool:
    """Whether a block is written in long format; binary ones are refused."""
    kind = header[73:75].strip()
    if kind not in ("0", "1", ""):
        raise InputError(f"{path}: is binary; write it in ASCII (*NODE FILE in place of *NODE OUTPUT)")
    return kind != "0"


def _read_lines(path: Path) -> list[str]:
    return path.read_text(encoding="ascii", errors="replace").splitlines()

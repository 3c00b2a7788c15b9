"""Pixel kernels of this checkout against those of another: rates and bits, one core.

Usage: python -m bench.kernel_rates [--before DIRECTORY] [PROBLEM ...]. Without a directory, the code before the
restructuring is checked out into bench/data. Two processes run the code before and one the code after, and their calls
take turns: before, after, before again, so that a change of the machine's speed meets all. Both of those before give
what the ratio is measured against, and one over the other the control: as far as it is from 1, a ratio says nothing.
A ratio of rates is the median over all turns, in CPU time.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.support.before import checkout_before
from bench.support.rows import Row, append_result, show
from bench.support.runs import DATA, ROOT, environment
from bench.support.unstructured_mesh import write_unstructured_mesh
from ddic.io.mesh_file import read_mesh
from ddic.mesh.mesh import Mesh, Similarity
from ddic.mesh.structured import build_structured_mesh

LEAST_RATIO = 0.97
"""Rate relative to that before that is good enough: what is left of the noise."""

ROUNDS = 60
"""Turns of each call; the median of fewer moves by more than LEAST_RATIO allows."""

MARGIN = 32
"""Pixels between the mesh and the image's edge."""


@dataclass(frozen=True)
class Problem:
    """A mesh and the degree of the spline.

    Attributes
    ----------
    mesh : callable
        Makes the mesh.
    degree : int
        3 or 5.
    """

    mesh: Callable[[], Mesh]
    degree: int


def square_mesh(side: int) -> Mesh:
    """Q4 of 16 px on a square region."""
    return build_structured_mesh((MARGIN, MARGIN, MARGIN + side, MARGIN + side), 16)


def mixed_mesh(side: int) -> Mesh:
    """Triangles and quadrangles of 15 px around a hole."""
    path = DATA / f"kernel_rates_mixed_{side}.vtk"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        low, high = MARGIN + 0.3, MARGIN + side - 0.4
        middle = MARGIN + side / 2
        write_unstructured_mesh(path, (low, low, high, high), 15.0, ((middle, middle), side / 8))
    return read_mesh(path, Similarity(), 2)


PROBLEMS = {
    "16-px Q4": Problem(lambda: square_mesh(1536), 3),
    "15-px T3/Q4": Problem(lambda: mixed_mesh(1536), 3),
    "16-px Q4, quintic": Problem(lambda: square_mesh(1536), 5),
    # Where what a call costs, whatever its cells, would show.
    "16-px Q4, 33,000 px": Problem(lambda: square_mesh(176), 3),
    "15-px T3/Q4, 33,000 px": Problem(lambda: mixed_mesh(183), 3),
}


class Checkout:
    """A process that measures one checkout's kernels, call by call.

    Parameters
    ----------
    directory : Path
        The checkout.
    mesh : Path
        The stored mesh.
    degree : int
        Of the spline.
    """

    def __init__(self, directory: Path, mesh: Path, degree: int) -> None:
        job = ROOT / "bench" / "support" / "kernel_rates_job.py"
        self._process = subprocess.Popen([sys.executable, str(job), str(mesh), str(degree)], text=True,
                                         stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                         env=environment({"PYTHONPATH": str(directory / "src")}))
        self.digests: dict[str, str] = json.loads(self._answer())

    def seconds(self, name: str) -> float:
        """CPU seconds of one call."""
        assert self._process.stdin is not None
        print(name, file=self._process.stdin, flush=True)
        return float(self._answer())

    def close(self) -> None:
        """End the process."""
        self._process.communicate()

    def _answer(self) -> str:
        """The process's next line; raises RuntimeError where it ended instead."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"the measuring process ended with {self._process.wait()}")
        return line


@contextmanager
def start_checkouts(before: Path, problem: Problem) -> Iterator[Sequence[Checkout]]:
    """Processes of the checkouts before, after and before again, ready to measure."""
    mesh = problem.mesh()
    stored = DATA / "kernel_rates_mesh.npz"
    stored.parent.mkdir(parents=True, exist_ok=True)
    np.savez(stored, nodes=mesh.nodes, connectivity=mesh.connectivity, offsets=mesh.offsets, types=mesh.types)
    checkouts: list[Checkout] = []
    try:
        for directory in (before, ROOT, before):
            checkouts.append(Checkout(directory, stored, problem.degree))
        yield checkouts
    finally:
        for checkout in checkouts:
            checkout.close()


def compare_rates(checkouts: Sequence[Checkout], call: str) -> tuple[float, float]:
    """Rate of a call after relative to that before, and that before again relative to that before."""
    ratios: list[float] = []
    controls: list[float] = []
    for _ in range(ROUNDS):
        before, after, again = (checkout.seconds(call) for checkout in checkouts)
        ratios.append((before + again) / 2 / after)
        controls.append(before / again)
    return float(np.median(ratios)), float(np.median(controls))


def measure_problem(name: str, before: Path) -> Row:
    """Compare all calls on one problem."""
    parts, ratios = [], []
    with start_checkouts(before, PROBLEMS[name]) as checkouts:
        expected, found = checkouts[0].digests, checkouts[1].digests
        for call in expected:
            same = found[call] == expected[call]
            ratio, control = compare_rates(checkouts, call)
            ratios.append(ratio)
            parts.append(f"{call} {ratio:.3f} ({control:.3f}{'' if same else ', other bits'})")
            append_result("kernel_rates", {"problem": name, "call": call, "ratio": ratio, "control": control,
                                           "same_bits": same})
    return Row(f"rates of pixel kernels, after to before, {name}", f">= {LEAST_RATIO} each",
               ", ".join(parts) + "; in parentheses before to before", min(ratios) >= LEAST_RATIO,
               judged_small=False)


def measure(before: Path | None = None, names: Sequence[str] = ()) -> Iterator[Row]:
    """Compare this checkout with another on the problems that are named, all where none is."""
    directory = checkout_before() if before is None else before
    for name in names or PROBLEMS:
        yield measure_problem(name, directory)


def main() -> int:
    """Print the rows; 1 where one does not hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--before", type=Path, help="the other checkout")
    parser.add_argument("problems", nargs="*", help=f"of {', '.join(PROBLEMS)}")
    arguments = parser.parse_args()
    held = True
    for row in measure(arguments.before, arguments.problems):
        held &= row.holds
        show(row)
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())

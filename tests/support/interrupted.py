"""A series that ends in the middle, and whether its results equal those of one that did not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from ddic.errors import as_collective
from ddic.methods.run import run_file
from ddic.parallel.team import Team
from support.cases import Ears, contents

NOT_REPEATED = ("phases", "date", "path", "records", "origin", "json", "seconds")
"""Parts of the names of what tells the time a run took, and where it stands."""


class Interrupted(Exception):
    """What ends a run in the middle of a frame."""


class EndsAt(Ears):
    """A listener that ends the run, on all ranks, when a frame begins to iterate."""

    def __init__(self, last: int) -> None:
        super().__init__()
        self.last = last

    def iteration(self, record: Any) -> None:
        super().iteration(record)
        if self.frames[-1] == self.last:
            raise as_collective(Interrupted("ended in the middle"))


def interrupt(path: Path, at: int) -> None:
    """Measure the frames of a case up to one, and end there; collective."""
    with pytest.raises(Interrupted):
        run_file(Team.world(), path, EndsAt(at))
    MPI.COMM_WORLD.barrier()


def assert_equal_results(one: Path, other: Path) -> None:
    """All datasets and attributes of two result files are equal in every bit, but for NOT_REPEATED."""
    first, second = contents(one), contents(other)
    assert first.keys() == second.keys()
    for name, values in first.items():
        if not any(word in name for word in NOT_REPEATED):
            np.testing.assert_array_equal(values, second[name], err_msg=name)

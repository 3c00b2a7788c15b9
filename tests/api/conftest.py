from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from mpi4py import MPI
from numpy.typing import NDArray

import ddic
from support.small_pair import SIZE, move


@pytest.fixture(scope="session")
def pair() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    return ddic.make_synthetic_pair(move, SIZE, noise=1, seed=1)


@pytest.fixture(scope="session")
def mesh() -> ddic.Mesh:
    return ddic.structured_mesh((20, 20, 140, 120), 20)


@pytest.fixture
def files(shared_path: Path, pair: tuple[NDArray[np.uint8], NDArray[np.uint8]]) -> tuple[Path, Path]:
    """The images of ``pair``."""
    paths = shared_path / "reference.tif", shared_path / "deformed.tif"
    if MPI.COMM_WORLD.rank == 0:
        for path, image in zip(paths, pair, strict=True):
            tifffile.imwrite(path, image)
    MPI.COMM_WORLD.barrier()
    return paths


@pytest.fixture
def case_file(files: tuple[Path, Path]) -> Path:
    """A case file of ``pair`` on ``mesh``."""
    path = files[0].with_name("case.toml")
    if MPI.COMM_WORLD.rank == 0:
        path.write_text('[images]\nreference = "reference.tif"\ndeformed = "deformed.tif"\n'
                        '[mesh.structured]\nregion = [20, 20, 140, 120]\nelement_size = 20\n'
                        '[solver]\nsubdomains = 4\n'
                        '[output]\nfile = "no_such_folder/result.vtkhdf"\n', encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    return path

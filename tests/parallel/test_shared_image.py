"""Images that are decoded once a node."""

from __future__ import annotations

import mmap
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from mpi4py import MPI

from ddic.errors import InputError, is_collective
from ddic.images.binned import ArraySource
from ddic.images.window import Window
from ddic.io.image_file import ImageFile, open_decoded
from ddic.parallel.node import open_once_a_node
from ddic.parallel.team import Team

RANKS = [1, 2, 3, 4]
HEIGHT, WIDTH = 70, 90


def _write(folder: Path, name: str, dtype: type = np.uint16, shape: tuple[int, ...] = (HEIGHT, WIDTH)) -> Path:
    path = folder / name
    if MPI.COMM_WORLD.rank == 0:
        pixels = np.random.default_rng(2).integers(0, np.iinfo(dtype).max, shape, endpoint=True, dtype=dtype)
        cv2.imwrite(str(path), pixels)
    MPI.COMM_WORLD.barrier()
    return path


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("name", "dtype", "shape"), [
    ("f.png", np.uint16, (HEIGHT, WIDTH)), ("f.bmp", np.uint8, (HEIGHT, WIDTH)),
    ("c.png", np.uint8, (HEIGHT, WIDTH, 3)),
])
def test_one_rank_decodes_once_and_all_read_the_same(shared_path: Path, name: str, dtype: type, shape: tuple[int, ...],
                                                     monkeypatch: pytest.MonkeyPatch) -> None:
    team = Team(MPI.COMM_WORLD)
    path = _write(shared_path, name, dtype, shape)
    alone = open_decoded(path)[0]
    decoded = []
    monkeypatch.setattr(cv2, "imread", lambda *a, read=cv2.imread: decoded.append(team.rank) or read(*a))
    image = open_once_a_node(team, lambda: open_decoded(path))
    windows = [Window.of_size(WIDTH, HEIGHT), Window((3, 5), (40, 60))]
    read = [np.array(image.read(w)) for w in windows]
    assert team.gather_lists(decoded) == [0]
    monkeypatch.undo()
    assert (image.path, image.width, image.height, image.saturation) == (path, WIDTH, HEIGHT, alone.saturation)
    for window, values in zip(windows, read, strict=True):
        np.testing.assert_array_equal(values, alone.read(window))
        assert values.dtype == alone.dtype
    with pytest.raises(ValueError, match="leaves the image"):
        image.read(Window.of_size(WIDTH + 1, HEIGHT))


@pytest.mark.parallel([2, 3, 4])
def test_the_ranks_of_a_node_hold_one_copy(shared_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    team = Team(MPI.COMM_WORLD)
    monkeypatch.setattr(tempfile, "tempdir", str(shared_path))
    path = _write(shared_path, "f.png")
    image = open_once_a_node(team, lambda: open_decoded(path))
    assert isinstance(image, ArraySource)
    base = image.values
    while isinstance(base, np.ndarray):
        base = base.base
    assert isinstance(base, mmap.mmap)
    with pytest.raises(ValueError, match="read-only"):
        image.values[0, 0] = 1
    # No file is left behind, and the pixels are still there.
    assert team.comm.allreduce(len(list(shared_path.glob("ddic-image-*")))) == 0
    assert len(set(team.gather_lists([int(image.values.astype(int).sum())]))) == 1


@pytest.mark.parallel(RANKS)
def test_an_image_that_is_read_by_windows_stays_a_file(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    path, calls = shared_path / "f.tif", []
    if team.is_root:
        tifffile.imwrite(path, np.zeros((HEIGHT, WIDTH), np.uint8))
    team.comm.barrier()
    image = open_once_a_node(team, lambda: calls.append(1) or open_decoded(path))
    assert isinstance(image, ImageFile)
    assert len(team.gather_lists(calls)) == 1


@pytest.mark.parallel(RANKS)
def test_an_unreadable_image_is_an_error_on_all_ranks(shared_path: Path) -> None:
    team = Team(MPI.COMM_WORLD)
    with pytest.raises(InputError, match="no such image file") as caught:
        open_once_a_node(team, lambda: open_decoded(shared_path / "none.png"))
    assert is_collective(caught.value)


@pytest.mark.parallel([2, 3, 4])
def test_no_room_for_the_pixels_is_an_error_on_all_ranks(shared_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    team = Team(MPI.COMM_WORLD)
    path = _write(shared_path, "f.png")
    monkeypatch.setattr(tempfile, "tempdir", str(shared_path / "gone"))
    with pytest.raises(InputError, match=f"its {2 * WIDTH * HEIGHT} bytes.*TMPDIR") as caught:
        open_once_a_node(team, lambda: open_decoded(path))
    assert is_collective(caught.value)

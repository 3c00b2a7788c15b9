"""The folder of a series that is not finished: a file for each frame that is, and what the next one needs.

Files are written while the program goes on, one after the other; others are brought into the system's cache before they
are needed.
"""

import json
import shutil
from collections.abc import Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import h5py

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.io import result_schema as schema
from ddic.io.damaged_result import open_hdf5
from ddic.io.replace_on_exit import made_folder, remove_abandoned, replaced_on_exit

ORIGIN = "series.json"
"""What the frames in a folder were measured from."""


@dataclass(frozen=True)
class FrameState:
    """What frames after a finished one need of it.

    Attributes
    ----------
    time : float
        Unit chosen by the user.
    unknowns : dict of int to (n_unknowns,) array
        By subdomain, since the first reference image.
    noise : tuple of float
        By which cameras are weighted, grey levels; empty with one camera.
    shown_share : float
        Share of the cells that were seen where the field put them.
    holds_back : bool
        Whether mechanics held cells back from where they were seen, so that the field shows no way to the next frame.
    """

    time: float
    unknowns: Mapping[int, Array]
    noise: tuple[float, ...]
    shown_share: float
    holds_back: bool


@dataclass(frozen=True)
class SeriesFolder:
    """Where the frames of a series stand until all are finished.

    Attributes
    ----------
    result : Path
        The result file of the whole series.
    n_frames : int
        That are to be measured.
    """

    result: Path
    n_frames: int

    @property
    def path(self) -> Path:
        """The folder, beside the result."""
        return schema.frames_path(self.result)

    def get_frame_path(self, number: int) -> Path:
        """Name the file of a finished frame, numbered from 1: a result file."""
        return self.path / f"{number:06d}.vtkhdf"

    def get_failure_path(self, number: int) -> Path:
        """Name the file that says why a frame, numbered from 1, could not be measured: its record."""
        return self.path / f"{number:06d}.failed.json"

    def begin(self, origin: Mapping[str, object], *, resume: bool) -> dict[int, str]:
        """Make the folder, or look what an earlier run left in it, and return records of the finished frames by number.

        ``origin`` is what the series is measured from, as JSON has it; ``resume`` asks to go on from what is there.
        Raises InputError where another series stands there, or one that shall not be gone on with.
        """
        if not self.path.exists():
            finished = self._read_whole(origin) if resume else {}
            if finished:
                return finished
            with made_folder(self.path), replaced_on_exit(self.path / ORIGIN) as temporary:
                temporary.write_text(json.dumps(origin), encoding="utf-8")
            return {}
        remove_abandoned(self.path)
        self._require_same(origin)
        finished = self._list_finished()
        if not resume and finished:
            raise InputError(f"{self.path} holds {len(finished)} of {self.n_frames} frames of a series that was not "
                             "finished: go on with --resume, or remove the folder to begin anew")
        return finished

    def _read_whole(self, origin: Mapping[str, object]) -> dict[int, str]:
        """Records of a series that an earlier run has finished; none where there is another file, or no file."""
        if not self.result.is_file() or not h5py.is_hdf5(self.result):
            return {}
        with open_hdf5(self.result) as file:
            if schema.STEPS not in file or file[schema.SERIES].attrs["origin"] != json.dumps(origin):
                return {}
            records = file[schema.SERIES]["records"].asstr()[...]
        return dict(enumerate(records, start=1)) if len(records) == self.n_frames else {}

    def _require_same(self, origin: Mapping[str, object]) -> None:
        try:
            before = json.loads((self.path / ORIGIN).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(f"{self.path}: stands where the frames of this series are kept, but is no such folder "
                             f"({error}); remove it, or choose another output.file") from error
        changed = sorted(key for key in {*before, *origin} if before.get(key) != origin.get(key))
        if changed:
            raise InputError(f"{self.path} holds frames of another series ({', '.join(changed)} differ); remove the "
                             "folder to begin anew, or choose another output.file")

    def _list_finished(self) -> dict[int, str]:
        found = {}
        for number in range(1, self.n_frames + 1):
            failed, finished = self.get_failure_path(number), self.get_frame_path(number)
            if finished.is_file():
                with open_hdf5(finished) as file:
                    found[number] = str(file[schema.SERIES].attrs["record"])
            elif failed.is_file():
                found[number] = failed.read_text(encoding="utf-8")
        return found

    def read_state(self, number: int) -> FrameState:
        """Read what the next frame needs of a finished one, numbered from 1: of all subdomains."""
        with open_hdf5(self.get_frame_path(number)) as file:
            group = file[schema.SERIES]
            unknowns = {int(name): values[...] for name, values in group["unknowns"].items()}
            return FrameState(float(group.attrs["time"]), unknowns, tuple(map(float, group.attrs["noise"])),
                              float(group.attrs["shown_share"]), bool(group.attrs["holds_back"]))

    def write_failure(self, number: int, record: str) -> None:
        """Note that a frame, numbered from 1, could not be measured; ``record`` says why, as JSON."""
        with replaced_on_exit(self.get_failure_path(number)) as temporary:
            temporary.write_text(record, encoding="utf-8")

    def remove(self) -> None:
        """Remove the folder with everything in it."""
        shutil.rmtree(self.path)


class BackgroundWriter:
    """Writes files in a thread of its own; use it in a ``with`` statement, which waits for the last one."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="ddic-writer")
        self._pending: Future[None] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._thread.shutdown(wait=True)
        if error is None:
            self.wait()

    def write(self, path: Path, content: bytes) -> None:
        """Begin to write a file, once the last one is written; it takes its name when it is complete.

        Raises OSError or InputError where the last one could not be written.
        """
        self.wait()
        self._pending = self._thread.submit(_write, path, content)

    def wait(self) -> None:
        """Wait for what is being written; raises OSError or InputError where it could not be."""
        pending, self._pending = self._pending, None
        if pending is not None:
            pending.result()


def _write(path: Path, content: bytes) -> None:
    with replaced_on_exit(path) as temporary:
        temporary.write_bytes(content)


CHUNK = 1 << 22
"""Bytes read at a time. Larger ones keep the disk busier, smaller ones stop sooner."""


class ReadAhead:
    """Reads files in a thread of its own and drops what it reads; use it in a ``with`` statement."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="ddic-reader")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._thread.shutdown(wait=True, cancel_futures=True)

    def begin(self, paths: Iterable[Path]) -> None:
        """Begin to read files; one that cannot be read is told of by whoever needs it."""
        for path in paths:
            self._thread.submit(_read, path)


def _read(path: Path) -> None:
    try:
        with path.open("rb", buffering=0) as file:
            while file.read(CHUNK):
                pass
    except OSError:
        return

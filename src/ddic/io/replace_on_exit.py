"""Files that take their names together, once they are complete; one run at a time writes a result."""

import fcntl
import os
import platform
import re
import time
import zlib
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path

from ddic.errors import InputError

FOREIGN_AGE = 86400.0
"""Seconds after which what another machine has begun and does not hold counts as abandoned: locks of a shared file
system may not reach from one machine to the other. A smaller value could take a file from a slow writer."""

_TEMPORARY = re.compile(r"\..+\.(?P<machine>[0-9a-f]{8})\.\d+\.tmp")

_UNFINISHED: set[Path] = set()
"""Of this process, for ``remove_unfinished``: a signal reaches a process, not the object that writes."""


def make_temporary_name(path: Path) -> Path:
    """Name a file under construction: in the folder of the final one, another for every process of every machine."""
    return path.with_name(f".{path.name}.{_name_machine()}.{os.getpid()}.tmp")


@dataclass
class NewFiles:
    """Files under construction, which take their names together.

    Attributes
    ----------
    begun : dict of Path to (Path, int)
        By the final name: the temporary one, and the descriptor that holds its lock.
    dropped : list of Path
        Files that do not belong to the new ones.
    """

    begun: dict[Path, tuple[Path, int]] = field(default_factory=dict)
    dropped: list[Path] = field(default_factory=list)

    def begin(self, path: Path) -> Path:
        """Begin a file of this final name: one that is there and empty, whose temporary name is returned.

        Raises InputError if the folder does not exist or cannot be written to, OSError if the disk takes no file.
        """
        if not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
            raise InputError(f"{path}: the folder {path.parent} does not exist or cannot be written to; "
                             "make it, or choose another output file")
        temporary = make_temporary_name(path)
        note_unfinished(temporary)
        self.begun[path] = temporary, -1
        descriptor = _open_locked(temporary, fcntl.LOCK_EX)
        self.begun[path] = temporary, descriptor
        os.ftruncate(descriptor, 0)
        return temporary

    def remove_old(self, path: Path) -> None:
        """Have a file, which need not be there, removed when the new ones take their names."""
        self.dropped.append(path)

    def publish(self) -> None:
        """Give all files their names, in the order in which they were begun."""
        for path in self.dropped:
            path.unlink(missing_ok=True)
        for path, (temporary, _) in self.begun.items():
            temporary.replace(path)

    def remove_unnamed(self) -> None:
        """Remove what has not got its name."""
        for temporary, descriptor in self.begun.values():
            with suppress(OSError):
                # Of a folder that can no longer be written to, nothing can be removed, but emptied.
                if descriptor >= 0 and os.path.samestat(temporary.stat(), os.fstat(descriptor)):
                    os.ftruncate(descriptor, 0)
                temporary.unlink(missing_ok=True)
            if descriptor >= 0:
                os.close(descriptor)
            _UNFINISHED.discard(temporary)


@contextmanager
def replaced_together() -> Iterator[NewFiles]:
    """Yield a set of new files: on a clean exit all take their names, on any other none does, and nothing is left.

    An OSError of the block is raised with the name of the file that could not be written.
    """
    files = NewFiles()
    try:
        yield files
        files.publish()
    except OSError as error:
        _name_file(error, files)
        raise
    finally:
        files.remove_unnamed()


def begin_files(files: NewFiles | None) -> AbstractContextManager[NewFiles]:
    """Add to a set of new files, where there is one, which whoever made it ends; or make one that stands by itself."""
    return replaced_together() if files is None else nullcontext(files)


@contextmanager
def replaced_on_exit(path: Path) -> Iterator[Path]:
    """Yield a temporary name that is renamed to ``path`` on a clean exit; raises InputError as ``NewFiles.begin``."""
    with replaced_together() as files:
        yield files.begin(path)


def note_unfinished(path: Path) -> None:
    """Have a file removed by ``remove_unfinished``."""
    _UNFINISHED.add(path)


def remove_unfinished() -> None:
    """Remove the files that this process has begun and not finished; for a process that is about to be killed.

    It may be called from another thread than the one that writes, whose next step then fails.
    """
    for temporary in tuple(_UNFINISHED):
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove_abandoned(folder: Path) -> None:
    """Remove what killed processes have left unfinished in a folder, if there: a living one holds its file's lock."""
    if not folder.is_dir():
        return
    for path in folder.glob(".*.tmp"):
        named = _TEMPORARY.fullmatch(path.name)
        if named is not None:
            with suppress(OSError):
                _remove_if_abandoned(path, is_ours=named["machine"] == _name_machine())


def _remove_if_abandoned(path: Path, *, is_ours: bool) -> None:
    """Remove a file that nobody holds; raises OSError where somebody does, or its file system knows no locks."""
    if not is_ours and time.time() - path.stat().st_mtime < FOREIGN_AGE:
        return
    descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        path.unlink(missing_ok=True)
    finally:
        os.close(descriptor)


def _open_locked(path: Path, operation: int) -> int:
    """Open a file, make it where it is not there, and lock it; the descriptor that holds the lock is returned.

    Raises BlockingIOError where another process has the lock and ``operation`` does not wait.
    """
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(descriptor, operation)
        except BlockingIOError:
            os.close(descriptor)
            raise
        except OSError:
            # A file system without locks: nothing is ever taken there for abandoned, or for held.
            return descriptor
        if os.fstat(descriptor).st_nlink:
            return descriptor
        # Between its making and its lock it was removed, as abandoned or by its last holder.
        os.close(descriptor)


def _name_file(error: OSError, files: NewFiles) -> None:
    """Name the file that could not be written as the user knows it; systems name the temporary one, or none."""
    finals = {str(temporary): path for path, (temporary, _) in files.begun.items()}
    named = finals.get(str(error.filename))
    if named is None and error.filename is None and finals:
        # What has no name of its own is a write that failed, of the file that was begun last.
        named = list(finals.values())[-1]
    if named is not None:
        error.filename = str(named)


def _name_machine() -> str:
    """Eight characters that tell machines apart, whatever the length of their names."""
    return f"{zlib.crc32(platform.node().encode()):08x}"


@contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder and those above it, if they are not there; where the block fails, remove the new ones if empty."""
    made = [one for one in (folder, *folder.parents) if not one.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for one in made:
            with suppress(OSError):
                one.rmdir()
        raise


LONGEST_NOTE = 200
"""Bytes of what a lock says of its holder."""


@contextmanager
def held_output(path: Path) -> Iterator[None]:
    """Hold a result's name while it is measured and written, and remove what killed runs have left in its folder.

    The lock is the system's, on a file ``.NAME.lock`` beside the result: it ends with the process that holds it. Where
    the file system knows no locks there is none. Raises InputError where another run has it, OSError where the disk
    takes no file.
    """
    lock = get_lock_path(path)
    try:
        descriptor = _open_locked(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(f"output.file: {path} is being written by another run ({_read_holder(lock)}); wait for its "
                         "end, or choose another name") from None
    except OSError as error:
        error.filename = str(path)
        raise
    _sign(descriptor)
    note_unfinished(lock)
    try:
        remove_abandoned(path.parent)
        yield
    finally:
        _UNFINISHED.discard(lock)
        with suppress(OSError):
            # Of a folder that can no longer be written to, nothing can be removed.
            lock.unlink(missing_ok=True)
        os.close(descriptor)


def get_lock_path(path: Path) -> Path:
    """Name the file whose lock a run holds while it measures and writes a result; it lies beside the result."""
    return path.with_name(f".{path.name}.lock")


def _read_holder(lock: Path) -> str:
    try:
        note = lock.read_text(encoding="utf-8", errors="replace")
    except OSError:
        note = ""
    return note[:LONGEST_NOTE].strip() or "another process"


def _sign(descriptor: int) -> None:
    """Say who holds the lock; a full disk is told of later, by what is written there."""
    try:
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"process {os.getpid()} on {platform.node()}\n".encode()[:LONGEST_NOTE], 0)
    except OSError:
        return

"""What is left, and what is said, where a disk is full or a limit of file sizes is reached at any byte of an output."""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from accept.support.ended_job import drop_launcher_lines
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import NotHereError, ddic, ddic_command, environment, images


@contextmanager
def small_disk(folder: Path, kib: int) -> Iterator[None]:
    """Mount a disk for as long as the block runs."""
    folder.mkdir()
    try:
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={kib}k", "tmpfs", str(folder)], text=True,
                              capture_output=True, check=False)
    except OSError as error:
        raise NotHereError(f"there is no mount here ({error})") from error
    if done.returncode:
        raise NotHereError(f"no disk can be mounted ({done.stderr.strip()})")
    try:
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)


N_SIZES = 20
LONGEST = 10.0
"""Seconds that all ranks may take to end, over what an undisturbed run takes."""

HANGS = 120.0
"""Seconds after which a run is killed."""

DISK_KIB = 32768
FRAMES = "result.frames"
"""Folder of a series' finished frames, beside its result."""

PAGE = 4096
"""Bytes that a disk in memory gives at a time."""

_CASE = ('[images]\nreference = "{images}/reference.tif"\ndeformed = {deformed}\n[mesh.structured]\n'
         'region = [16, 16, 112, 112]\nelement_size = 16\n[solver]\nmethod = "dual"\nsubdomains = 2\n[output]\n'
         'file = "{out}/result.vtkhdf"\n')


@dataclass(frozen=True)
class Job:
    """A command that writes.

    Attributes
    ----------
    name : str
        In the table.
    words : tuple of str
        Of ``ddic``.
    folder : Path
        Where it writes.
    """

    name: str
    words: tuple[str, ...]
    folder: Path

    def start(self, n_ranks: int, limit_kib: int | None) -> tuple[int, list[str], float]:
        """Run it; exit code, ddic's lines on standard error, seconds."""
        command = [ddic_command(), *self.words]
        if n_ranks > 1:
            command = ["mpiexec", "-n", str(n_ranks), *command]
        if limit_kib is not None:
            command = ["bash", "-c", f'ulimit -f {limit_kib}; exec "$0" "$@"', *command]
        began = time.perf_counter()
        done = subprocess.run(["timeout", "-k", "5", str(HANGS), *command], env=environment(), text=True,
                              capture_output=True, check=False)
        return done.returncode, drop_launcher_lines(done.stderr), time.perf_counter() - began


def measure_full_disks(scale: Scale) -> list[Row]:
    """Run commands over older outputs with disks and limits of many sizes, on one rank and on two."""
    folder = scale.folder("full_disks")
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "limited").mkdir(parents=True)
    rows = [_measure_limits(folder, scale)]
    try:
        with small_disk(folder / "disk", DISK_KIB):
            rows.append(_measure_disks(folder, scale))
    except NotHereError as error:
        rows.append(Row("a full disk", "measured", f"not measured: {error}", False, judged_small=False))
    return rows


def _measure_limits(folder: Path, scale: Scale) -> Row:
    trials = []
    for job in _prepare(folder, folder / "limited", scale):
        seconds, new = _find_new(job)
        largest = max(new.values())
        # Shells count KiB: from nothing to just short of the largest file.
        sizes = sorted({int(share * (largest - 1) / 1024) for share in _choose_shares(job, scale)})
        for number, size in enumerate(sizes):
            trials.append(_try(job, seconds, 1 + number % 2 * _can_be_parallel(job), size))
            trials[-1] += _resume(job)
    return _judge("a limit of file sizes", trials)


def _measure_disks(folder: Path, scale: Scale) -> Row:
    disk, filler = folder / "disk", folder / "disk" / "filler"
    trials = []
    for job in _prepare(folder, disk, scale):
        seconds, new = _find_new(job)
        needed = sum(-(-size // PAGE) * PAGE for size in new.values())
        for number, share in enumerate(_choose_shares(job, scale)):
            free = shutil.disk_usage(disk).free
            room = int(share * (needed - PAGE)) // PAGE * PAGE
            filler.write_bytes(bytes(max(free - room, 0)))
            trials.append(_try(job, seconds, 1 + number % 2 * _can_be_parallel(job), None))
            filler.unlink()
            trials[-1] += _resume(job)
    return _judge("a full disk", trials)


def _choose_shares(job: Job, scale: Scale) -> list[float]:
    """Parts of an output that the disk takes: many of a run's, two of those of others."""
    if scale.smoke:
        return [0.6]
    return [number / N_SIZES for number in range(N_SIZES)] if job.name == "run" else [0.0, 0.6]


def _can_be_parallel(job: Job) -> bool:
    return job.name in ("run", "run of a series")


def _prepare(folder: Path, out: Path, scale: Scale) -> Iterator[Job]:
    """Commands, with older outputs where they write."""
    pair = images("translation", "--size", "128x128", "--seed", "1", folder=folder / "images")
    # A second frame of its own: one that is the reference image is warned of.
    shutil.copy(pair / "deformed.tif", pair / "later.tif")
    ways = {"run": '"{0}/deformed.tif"', "run of a series": '["{0}/deformed.tif", "{0}/later.tif"]'}
    for number, (name, deformed) in enumerate(ways.items()):
        place = out / f"run_{number}"
        place.mkdir()
        case = folder / f"{out.name}_{number}.toml"
        case.write_text(_CASE.format(images=pair, deformed=deformed.format(pair), out=place), encoding="utf-8")
        ddic("run", str(case))
        yield Job(name, ("run", str(case)), place)
        if scale.smoke:
            return
    result = folder / "result.vtkhdf"
    shutil.copy(out / "run_0" / "result.vtkhdf", result)
    for name, words in {
        "plot": ("--kind", "partition", "--output", "{0}"), "export": ("--csv", "{0}/table.csv"),
        "report": ("--output", "{0}/page.html"), "probe": ("--line", "20,20,90,90", "--csv", "{0}/probes.csv"),
    }.items():
        place = out / name
        place.mkdir()
        job = Job(name, (name, str(result), *(word.format(place) for word in words)), place)
        ddic(*job.words)
        yield job
    place = out / "synth"
    place.mkdir()
    job = Job("synth", ("synth", "translation", "--size", "128x128", "--output", str(place)), place)
    ddic(*job.words)
    yield job


def _find_new(job: Job) -> tuple[float, dict[str, int]]:
    """Seconds of an undisturbed run on one rank, and the sizes of what it writes."""
    code, lines, seconds = job.start(1, None)
    if code:
        raise RuntimeError(f"{job.name} ended with {code}: {lines}")
    return seconds, {path.name: path.stat().st_size for path in job.folder.iterdir()}


def _try(job: Job, seconds: float, n_ranks: int, limit_kib: int | None) -> list[str]:
    """Run a command that cannot write all; what is wrong with how it ends."""
    before = _read(job.folder)
    code, lines, taken = job.start(n_ranks, limit_kib)
    wrong = [] if code == 1 else [f"exit code {code}"]
    if len(lines) != 1:
        wrong.append(f"{len(lines)} lines ({lines[:1]})")
    if taken > seconds + LONGEST:
        wrong.append(f"{taken:.0f} s")
    after = _read(job.folder)
    if any(after.get(name) != content for name, content in before.items()):
        wrong.append("an older file changed")
    left = sorted(set(after) - set(before) - set(_list_finished_frames(job)))
    if left:
        wrong.append(f"left {left}")
    return [f"{job.name} on {n_ranks}: {one}" for one in wrong]


def _list_finished_frames(job: Job) -> list[str]:
    """What a series keeps of the frames that it has measured: one with --resume goes on from them."""
    kept = [path for path in (job.folder / FRAMES).glob("*") if path.suffix in (".vtkhdf", ".json")]
    return [str(path.relative_to(job.folder)) for path in kept if not path.name.startswith(".")]


def _resume(job: Job) -> list[str]:
    """Go on from what a series has kept, now that there is room; what is wrong with how that ends."""
    if not _list_finished_frames(job):
        return []
    code, lines, _ = replace(job, words=(*job.words, "--resume")).start(1, None)
    wrong = [f"{job.name}, resumed: exit code {code}: {lines[:1]}"] if code else []
    return wrong + ([f"{job.name}, resumed: frames are left"] if (job.folder / FRAMES).exists() else [])


def _read(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _judge(what: str, trials: Sequence[Sequence[str]]) -> Row:
    wrong = [line for trial in trials for line in trial]
    n_right = sum(not trial for trial in trials)
    found = f"{n_right} of {len(trials)} so" + (f"; {'; '.join(wrong[:5])}" if wrong else "")
    return Row(f"{what}: run at {N_SIZES} sizes on 1 and 2 ranks, six other commands at 2",
               f"exit code 1, one line, within {LONGEST:g} s, the older files intact, nothing left but "
               "frames that a series has finished, from which it is resumed", found, not wrong)

"""A measurement as a job of a real Slurm of this machine: the result of mpirun, a clean stop ahead of the limit.

The Slurm lasts as long as a test: munged, slurmctld and slurmd in a folder, on the loopback. The batch scripts of
``scripts/`` are edited in their three places as a user does.
"""

from __future__ import annotations

import getpass
import os
import re
import shutil
import socket
import subprocess
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import ddic
from accept.series_runs import find_unequal_datasets
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ROOT, NotHereError, ddic_command, images, mpirun


def edit_job_script(system: str, case_file: Path, changes: dict[str, str] | None = None,
                    program: str | None = None) -> Path:
    """Copy a batch script beside a case, with the program and the case filled in."""
    text = (ROOT / "scripts" / system / "job.sh").read_text(encoding="utf-8")
    places = re.findall(r"^# EDIT (\d) of 3: ", text, flags=re.MULTILINE)
    if places != ["1", "2", "3"]:
        raise ValueError(f"scripts/{system}/job.sh: places to edit are {places}")
    filled = {"ddic=/path/to/ddic/.venv/bin/ddic": f"ddic={program or ddic_command()}",
              "case_file=/path/to/measurement/case.toml": f"case_file={case_file}", **(changes or {})}
    for old, new in filled.items():
        if text.count(old) != 1:
            raise ValueError(f"scripts/{system}/job.sh: {old!r} stands there {text.count(old)} times")
        text = text.replace(old, new)
    script = case_file.parent / "job.sh"
    script.write_text(text, encoding="utf-8")
    return script


PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "srun", "setpriv")
"""Those of Debian's slurm-wlm and munge."""

INSTALL = "apt-get install --no-install-recommends slurm-wlm munge libpmix-dev"
"""Without libpmix-dev, Slurm's PMIx plugin finds no library, and ``srun`` starts no rank."""

LIMIT_S = 30.0
"""Seconds for a daemon to come up, or to end."""

_WORDS = """\
ClusterName=one
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller_port}
SlurmdPort={node_port}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
CredType=cred/munge
AuthInfo=socket={folder}/munge.socket
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
ProctrackType=proctrack/pgid
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
MpiDefault=none
ReturnToService=2
KillWait=10
NodeName={host} NodeAddr=127.0.0.1 CPUs={n_cores} State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


@dataclass(frozen=True)
class Slurm:
    """A running Slurm.

    Attributes
    ----------
    folder : Path
        Of its configuration, state and logs.
    """

    folder: Path

    def environment(self) -> dict[str, str]:
        """Give the environment in which its commands find it."""
        return {**os.environ, "SLURM_CONF": str(self.folder / "slurm.conf")}

    def ask(self, *command: str) -> str:
        """Run one of its commands."""
        done = subprocess.run(command, env=self.environment(), capture_output=True, text=True, check=False,
                              timeout=LIMIT_S)
        if done.returncode != 0:
            raise RuntimeError(f"{' '.join(command)}: exit code {done.returncode}: {done.stderr.strip()}")
        return done.stdout.strip()

    def submit(self, script: Path, *options: str) -> int:
        """Submit a batch script, from its folder."""
        return int(self.ask("sbatch", "--parsable", f"--chdir={script.parent}", *options, str(script)))

    def state(self, job: int) -> dict[str, str]:
        """Give what Slurm knows of a job."""
        words = self.ask("scontrol", "--oneliner", "show", "job", str(job)).split()
        return dict(word.split("=", 1) for word in words if "=" in word)

    def wait(self, job: int, seconds: float) -> dict[str, str]:
        """Wait for the end of a job.

        Parameters
        ----------
        job : int
            Its number.
        seconds : float
            To wait at most.

        Returns
        -------
        dict
            Its state.
        """
        ended = ("COMPLETED", "FAILED", "CANCELLED", "TIMEOUT", "NODE_FAIL")
        _wait_until(lambda: self.state(job)["JobState"] in ended, f"job {job} to end", seconds)
        return self.state(job)


@contextmanager
def one_machine_slurm() -> Iterator[Slurm]:
    """Start the three daemons in a temporary folder, and end them with all jobs."""
    absent = [name for name in PROGRAMS if _find(name) is None]
    if absent:
        raise NotHereError(f"no {', '.join(absent)}: {INSTALL}")
    with ExitStack() as ends:
        # A socket's path may be 107 characters long: not below a test's own folder.
        folder = Path(ends.enter_context(tempfile.TemporaryDirectory(prefix="ddic-slurm-", dir="/tmp",
                                                                     ignore_cleanup_errors=True)))
        _configure(folder)
        slurm = Slurm(folder)
        key, munge = folder / "munge.key", folder / "munge.socket"
        ends.enter_context(_daemon(folder, "munged", "--foreground", "--force", f"--key-file={key}",
                                   f"--socket={munge}", f"--pid-file={folder}/munged.pid",
                                   f"--seed-file={folder}/munged.seed"))
        _wait_until(munge.exists, "munged", LIMIT_S)
        ends.enter_context(_daemon(folder, "slurmctld", "-D", "-i"))
        ends.enter_context(_daemon(folder, "slurmd", "-D"))
        _wait_until(lambda: _is_idle(slurm), f"an idle node; {_tails(folder)}", LIMIT_S)
        ends.callback(_cancel_all, slurm)
        _require_pmix(slurm)
        yield slurm


def _require_pmix(slurm: Slurm) -> None:
    """Any other fault of srun is Slurm's, and stays one."""
    try:
        slurm.ask("srun", "--ntasks=1", "--mpi=pmix", "true")
    except RuntimeError as error:
        if "can not load PMIx library" not in str(error):
            raise
        raise NotHereError(f"srun finds no PMIx library: {INSTALL}") from error


def _find(program: str) -> str | None:
    return shutil.which(program, path=f"{os.environ['PATH']}:/usr/sbin:/sbin")


def _configure(folder: Path) -> None:
    for name in ("state", "spool"):
        (folder / name).mkdir()
    key = folder / "munge.key"
    key.write_bytes(os.urandom(1024))
    key.chmod(0o400)
    # Both at once, so that they differ.
    with socket.socket() as one, socket.socket() as other:
        one.bind(("127.0.0.1", 0))
        other.bind(("127.0.0.1", 0))
        ports = one.getsockname()[1], other.getsockname()[1]
    words = _WORDS.format(host=socket.gethostname().split(".")[0], folder=folder, user=getpass.getuser(),
                          controller_port=ports[0], node_port=ports[1], n_cores=os.cpu_count())
    (folder / "slurm.conf").write_text(words, encoding="utf-8")


@contextmanager
def _daemon(folder: Path, program: str, *options: str) -> Iterator[None]:
    """Run a daemon in the foreground; should this process be killed, the system ends it."""
    command = ["setpriv", "--pdeathsig", "TERM", str(_find(program)), *options]
    with (folder / f"{program}.log").open("w", encoding="utf-8") as log:
        process = subprocess.Popen(command, env=Slurm(folder).environment(), stdout=log, stderr=subprocess.STDOUT,
                                   stdin=subprocess.DEVNULL, start_new_session=True)
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(LIMIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _is_idle(slurm: Slurm) -> bool:
    try:
        return slurm.ask("sinfo", "--noheader", "--format=%T") == "idle"
    except RuntimeError:
        return False


def _cancel_all(slurm: Slurm) -> None:
    """End all jobs, so that no process of theirs outlives the daemons."""
    try:
        slurm.ask("scancel", "--full", f"--user={getpass.getuser()}")
        _wait_until(lambda: not slurm.ask("squeue", "--noheader"), "the end of all jobs", LIMIT_S)
    except RuntimeError:
        pass


def _tails(folder: Path) -> str:
    logs = sorted(folder.glob("*.log"))
    return "; ".join(f"{log.name}: {' / '.join(log.read_text().splitlines()[-5:])}" for log in logs)


def _wait_until(holds: Callable[[], bool], what: str, seconds: float) -> None:
    limit = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > limit:
            raise RuntimeError(f"waited {seconds:.0f} s in vain for {what}")
        time.sleep(0.2)


LAUNCHERS = ("mpirun", "srun --mpi=pmix")

LONGEST_S = 400.0
"""Seconds after which a job counts as hanging."""

STOP_OPTIONS = ("--time=00:03:00", "--signal=B:USR1@120")
"""Slurm looks every 30 s, hence signals between 30 and 60 s from the beginning: the run must iterate then, or be about
to, and iterates once at least; it has two minutes left."""

_ENDLESS = "[gauss_newton]\ntolerance = 1e-300\nrms_tolerance = 1e-300\nlargest_tolerance = 1e-300\n"


def measure_slurm_job(scale: Scale) -> list[Row]:
    """Run the batch script of ``scripts/slurm`` with two tasks, under either launcher."""
    folder = scale.folder("slurm")
    case = _write_case(folder / "mpirun", 600 if scale.smoke else 1200, 15)
    mpirun(2, ddic_command(), "run", str(case))
    with one_machine_slurm() as slurm:
        rows = [_compare(slurm, launcher, case) for launcher in LAUNCHERS]
        case = _write_case(folder / "long", 600 if scale.smoke else 3600, 6, _ENDLESS)
        rows += [_stop(slurm, launcher, case) for launcher in LAUNCHERS]
    return rows


def _write_case(folder: Path, side: int, element_size: int, more: str = "") -> Path:
    """A plate with a hole in tension, of two subdomains a rank, with nothing left in its folder."""
    shutil.rmtree(folder, ignore_errors=True)
    images("kirsch", "--size", f"{side}x{side}", "--strain", "0.005", "--radius", str(side // 12), "--noise", "2",
           "--seed", "1", folder=folder / "images")
    centre = (side - 1) / 2
    (folder / "case.toml").write_text(
        '[images]\nreference = "images/reference.tif"\ndeformed = "images/deformed.tif"\n'
        f"[mesh.structured]\nregion = [50, 50, {side - 50}, {side - 50}]\nelement_size = {element_size}\n"
        f"circles = [{{ center = [{centre}, {centre}], radius = {side // 12} }}]\n"
        "[regularization]\ncut_off_wavelength = 200\n"
        'not_controlled = ["left", "right", "top", "bottom"]\n[solver]\nmethod = "dual"\nsubdomains = 8\n'
        f'{more}[output]\nfile = "result.vtkhdf"\n', encoding="utf-8")
    return folder / "case.toml"


def _submit(slurm: Slurm, launcher: str, case: Path, *options: str) -> tuple[dict[str, str], str]:
    """State of a finished job, and its log."""
    export = f"--export=ALL,DDIC_LAUNCH={launcher}"
    job = slurm.submit(edit_job_script("slurm", case), export, *options)
    state = slurm.wait(job, LONGEST_S)
    return state, (case.parent / f"ddic-{job}.log").read_text(encoding="utf-8")


def _compare(slurm: Slurm, launcher: str, case: Path) -> Row:
    """A row on the same case as mpirun had outside of Slurm."""
    inside = case.parent.with_name("job")
    shutil.rmtree(inside, ignore_errors=True)
    inside.mkdir()
    shutil.copytree(case.parent / "images", inside / "images")
    state, log = _submit(slurm, launcher, Path(shutil.copy(case, inside)))
    result = inside / "result.vtkhdf"
    if not result.is_file():
        return Row(f"Slurm job, 2 tasks, {launcher}", "same result as mpirun", f"none: {log[-400:]}", False)
    n_compared, unequal = find_unequal_datasets(case.parent / "result.vtkhdf", result)
    measured = (f"{state['JobState']}, exit code {state['ExitCode']}; of {n_compared} datasets {len(unequal)} differ "
                f"in any bit {' '.join(unequal)}").strip()
    on_two = "on 2 ranks" in log
    return Row(f"Slurm job, 2 tasks, {launcher}", "same result as mpirun outside of Slurm", measured,
               on_two and not unequal and state["ExitCode"] == "0:0")


def _stop(slurm: Slurm, launcher: str, case: Path) -> Row:
    """A row on a job that Slurm signals ahead of the end of its time."""
    for left in (*case.parent.glob("result*"), *case.parent.glob("ddic-*")):
        left.unlink()
    state, log = _submit(slurm, launcher, case, *STOP_OPTIONS)
    kept = case.parent / "result.not_converged.vtkhdf"
    said = next((line for line in log.splitlines() if line.startswith("stopped by a signal")), "no stop")
    is_kept = kept.is_file() and _is_readable(kept)
    rubbish = [path.name for path in case.parent.glob(".*")]
    measured = (f"{state['JobState']}, exit code {state['ExitCode']} after {state['RunTime']}; "
                f"{said.split(';')[0]}; last field {'kept and marked' if is_kept else 'lost'}; "
                f"{len(rubbish)} temporary files left")
    return Row(f"walltime signal, {launcher}", "clean stop: exit code 3, last field kept, before the limit of 3 min",
               measured, is_kept and state["ExitCode"] == "3:0" and not rubbish, judged_small=False)


def _is_readable(kept: Path) -> bool:
    with warnings.catch_warnings():
        # That it did not converge is what is asked here.
        warnings.simplefilter("ignore", UserWarning)
        return not ddic.open(kept).converged

"""A Slurm of one machine, for as long as a test lasts: munged, slurmctld and slurmd in a folder, on the loopback."""

from __future__ import annotations

import getpass
import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from bench.support.runs import NotHereError

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
        """Run one of its commands.

        Parameters
        ----------
        *command : str
            The command and its arguments.

        Returns
        -------
        str
            Its output, without blanks about it.

        Raises
        ------
        RuntimeError
            Where it fails.
        """
        done = subprocess.run(command, env=self.environment(), capture_output=True, text=True, check=False,
                              timeout=LIMIT_S)
        if done.returncode != 0:
            raise RuntimeError(f"{' '.join(command)}: exit code {done.returncode}: {done.stderr.strip()}")
        return done.stdout.strip()

    def submit(self, script: Path, *options: str) -> int:
        """Submit a batch script, from its folder.

        Parameters
        ----------
        script : Path
            The script.
        *options : str
            Of sbatch.

        Returns
        -------
        int
            Number of the job.
        """
        return int(self.ask("sbatch", "--parsable", f"--chdir={script.parent}", *options, str(script)))

    def state(self, job: int) -> dict[str, str]:
        """Give what Slurm knows of a job.

        Parameters
        ----------
        job : int
            Its number.

        Returns
        -------
        dict
            Words of ``scontrol show job`` by name: JobState, ExitCode and others.
        """
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
    """Start the three daemons in a temporary folder, and end them with all jobs.

    Yields
    ------
    Slurm
        Whose one node is idle.

    Raises
    ------
    NotHereError
        Where Slurm or its PMIx library is not installed.
    RuntimeError
        Where a daemon does not come up, with its log.
    """
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

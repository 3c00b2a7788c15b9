"""Two hosts on one machine: network namespaces with a wire between them, and MPI over TCP."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from bench.support.runs import NotHereError

NETWORK = "10.213.77"
"""First three numbers of the hosts' addresses."""

_AGENT = """\
#!/bin/sh
# mpirun calls: HOST COMMAND...; {network}.N is namespace {prefix}N, with a hostname and a /dev/shm of its own.
number="${{1##*.}}"
shift
exec ip netns exec "{prefix}$number" unshare --uts --mount --ipc sh -c \\
    "hostname host$number; mount -t tmpfs tmpfs /dev/shm; $*"
"""


@dataclass(frozen=True)
class TwoHosts:
    """Two network namespaces that see nothing but each other.

    Attributes
    ----------
    prefix : str
        Their names less the number, 1 or 2.
    agent : Path
        Program that starts a command on a host, as ssh does.
    """

    prefix: str
    agent: Path

    def run(self, ranks: tuple[int, int], *command: str, seconds: float = 300.0) -> subprocess.CompletedProcess[str]:
        """Run a command under mpirun, ranks spread over both hosts.

        Parameters
        ----------
        ranks : tuple of int
            On the first host and on the second.
        *command : str
            The command and its arguments.
        seconds : float
            After which it counts as hanging.

        Returns
        -------
        CompletedProcess
            With its output and exit code.
        """
        hosts = ",".join(f"{NETWORK}.{number}:{n}" for number, n in zip((1, 2), ranks, strict=True))
        over_tcp = ["--mca", "btl", "tcp,self", "--mca", "btl_tcp_if_include", f"{NETWORK}.0/24",
                    "--mca", "oob_tcp_if_include", f"{NETWORK}.0/24", "--mca", "pml", "ob1"]
        # What a remote rank's environment lacks is what a login shell sets; here it is this process's.
        passed = [word for name in ("PATH", "PYTHONPATH", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_CACHE_DIR")
                  if name in os.environ for word in ("-x", name)]
        launch = ["mpirun", "--host", hosts, "-n", str(sum(ranks)), "--mca", "plm_rsh_agent", str(self.agent),
                  *over_tcp, *passed]
        first = ["ip", "netns", "exec", f"{self.prefix}1", "unshare", "--uts", "sh", "-c",
                 'hostname host1; exec "$@"', "sh"]
        return subprocess.run([*first, *launch, *command], capture_output=True, text=True, check=False,
                              timeout=seconds, env=dict(os.environ))

    def count_bytes(self) -> int:
        """Count what has gone over the wire, both ways.

        Returns
        -------
        int
            Bytes.
        """
        lines = _do("ip", "netns", "exec", f"{self.prefix}1", "cat", "/proc/net/dev").splitlines()
        words = next(line for line in lines if line.strip().startswith("wire1:")).split(":")[1].split()
        return int(words[0]) + int(words[8])


@contextmanager
def two_hosts(folder: Path) -> Iterator[TwoHosts]:
    """Make two namespaces and the wire, and remove them.

    Parameters
    ----------
    folder : Path
        For the launch agent.

    Yields
    ------
    TwoHosts
        Both up.

    Raises
    ------
    NotHereError
        Where the machine does not allow it.
    """
    if shutil.which("ip") is None or shutil.which("unshare") is None:
        raise NotHereError("no ip or unshare: apt-get install iproute2 util-linux")
    prefix = f"ddic{os.getpid()}-"
    with ExitStack() as ends:
        for number in (1, 2):
            try:
                _do("ip", "netns", "add", f"{prefix}{number}")
            except RuntimeError as error:
                raise NotHereError(f"no network namespaces here, which takes root: {error}") from error
            ends.callback(_do, "ip", "netns", "del", f"{prefix}{number}")
        _do("ip", "link", "add", "wire1", "netns", f"{prefix}1", "type", "veth", "peer", "name", "wire2",
            "netns", f"{prefix}2")
        for number in (1, 2):
            inside = ("ip", "-n", f"{prefix}{number}")
            _do(*inside, "addr", "add", f"{NETWORK}.{number}/24", "dev", f"wire{number}")
            for device in ("lo", f"wire{number}"):
                _do(*inside, "link", "set", device, "up")
        agent = folder / "launch_agent"
        agent.write_text(_AGENT.format(network=NETWORK, prefix=prefix), encoding="utf-8")
        agent.chmod(0o755)
        yield TwoHosts(prefix, agent)


def _do(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip() or done.returncode}")
    return done.stdout

"""Processes that run commands of ddic, begun again when they die and killed when they hang."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from accept.trials.command_worker import STDERR, STDOUT
from bench.support.runs import ROOT, environment

LIMIT_S = 20.0
"""Seconds after which a command counts as hanging."""

MOST_COMMANDS = 400
"""Commands of one process: what libraries keep of each would add up."""

TO_BEGIN_S = 120.0
"""Seconds in which a process has to be there: it imports everything first."""


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes
    ----------
    code : int
        Exit code; less a signal's number where that ended it; HUNG where it was killed as hanging.
    stdout, stderr : str
        What was printed.
    peak : int
        Largest memory, bytes; 0 where it is not known.
    seconds : float
        Wall time.
    """

    code: int
    stdout: str
    stderr: str
    peak: int
    seconds: float


HUNG = -999
"""In place of an exit code."""


class Worker:
    """One process that runs commands; a context manager."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._requests = self._answers = -1
        self._n_commands = 0

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def run(self, folder: Path, arguments: Sequence[str], variables: Mapping[str, str] | None = None) -> Ended:
        """Run a command."""
        if self._n_commands >= MOST_COMMANDS:
            self._end()
        began = time.perf_counter()
        answer = self._ask({"folder": str(folder), "arguments": list(arguments), "environment": dict(variables or {})})
        printed = [_read(folder.parent / name) for name in (STDOUT, STDERR)]
        return Ended(answer["code"], printed[0], printed[1], answer["peak"], time.perf_counter() - began)

    def _ask(self, request: Mapping[str, object]) -> dict[str, int]:
        if self._process is None:
            self._begin()
            ready = self._wait_for_answer(TO_BEGIN_S)
            if ready["code"] != 0:
                raise RuntimeError(f"the process that runs commands did not begin: {ready['code']}")
        self._n_commands += 1
        os.write(self._requests, (json.dumps(request) + "\n").encode())
        return self._wait_for_answer(LIMIT_S)

    def _wait_for_answer(self, seconds: float) -> dict[str, int]:
        """The next answer; how the process ended where none came."""
        deadline, received = time.perf_counter() + seconds, b""
        while not received.endswith(b"\n"):
            left = deadline - time.perf_counter()
            if left <= 0 or not select.select([self._answers], [], [], left)[0]:
                self._end()
                return {"code": HUNG, "peak": 0}
            chunk = os.read(self._answers, 65536)
            if not chunk:
                assert self._process is not None
                code = self._process.wait()
                self._end()
                return {"code": code, "peak": 0}
            received += chunk
        answer: dict[str, int] = json.loads(received)
        return answer

    def _begin(self) -> None:
        their_requests, self._requests = os.pipe()
        self._answers, their_answers = os.pipe()
        command = [sys.executable, "-m", "accept.trials.command_worker", str(their_requests), str(their_answers)]
        self._process = subprocess.Popen(command, cwd=ROOT, env=environment(), stdin=subprocess.DEVNULL,
                                         pass_fds=(their_requests, their_answers), start_new_session=True)
        os.close(their_requests)
        os.close(their_answers)
        self._n_commands = 0

    def _end(self) -> None:
        if self._process is None:
            return
        os.close(self._requests)
        os.close(self._answers)
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGKILL)
        self._process.wait()
        self._process = None


def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""



"""A process that runs commands of ddic one after the other, since starting one takes longer than refusing an input.

Usage: python -m accept.trials.command_worker REQUESTS ANSWERS, two file descriptors. A request is a JSON line with
"folder", "arguments" and "environment"; the answer one with "code" and "peak", bytes. A first answer, to no request,
says that all is imported. What a command prints is in the
files stdout and stderr beside its folder.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import json
import os
import resource
import signal
import sys
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

MOST_ADDRESSES = 6 << 30
"""Bytes of address space: what asks for more fails in this process and does not fill the machine."""

PR_SET_PDEATHSIG = 1
IMPORTED_LATER = ("ddic.check.case", "ddic.plots.maps", "ddic.report.page",
                  "ddic.methods.run", "ddic.plots.canvas")
"""What commands import when they are called: no command's time holds it."""

STDOUT, STDERR = "stdout", "stderr"


def serve(requests: int, answers: int) -> None:
    """Run commands until no request comes."""
    # Who asks may be killed, and this process hang: neither would end the other.
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    from ddic.cli.app import command_line

    everything = click.Context(command_line)
    for name in command_line.list_commands(everything):
        command_line.get_command(everything, name)
    for name in IMPORTED_LATER:
        importlib.import_module(name)
    resource.setrlimit(resource.RLIMIT_AS, (MOST_ADDRESSES, MOST_ADDRESSES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with os.fdopen(requests, encoding="utf-8") as incoming, os.fdopen(answers, "w", encoding="utf-8") as outgoing:
        print(json.dumps({"code": 0, "peak": 0}), file=outgoing, flush=True)
        at_begin = _read_memory("VmRSS")
        for line in incoming:
            print(json.dumps(_answer(json.loads(line), at_begin)), file=outgoing, flush=True)


def _answer(request: Mapping[str, Any], at_begin: int) -> dict[str, int]:
    """Run a command; ``at_begin`` is what this process held before its first one, bytes."""
    # Else the peak would be that of an earlier command.
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    held = _read_memory("VmRSS")
    folder = Path(request["folder"])
    with _in_folder(folder), _environment(request["environment"]), _printing_to(folder.parent):
        code = _run(request["arguments"])
    # What thousands of earlier commands have left in this process a process of its own would not hold.
    return {"code": code, "peak": _read_memory("VmHWM") - held + at_begin}


def _run(arguments: list[str]) -> int:
    """Run one command as its process would; returns the exit code."""
    from ddic.cli.app import command_line

    # What an earlier command was warned of would not be said again.
    warnings.resetwarnings()
    for module in list(sys.modules.values()):
        getattr(module, "__warningregistry__", {}).clear()
    try:
        command_line.main(arguments, prog_name="ddic")
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        sys.excepthook(*sys.exc_info())
        return 1
    return 0


def _read_memory(name: str) -> int:
    """Memory of this process, bytes: VmRSS that it holds, VmHWM the most that it held since that was cleared."""
    line = next(line for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines()
                if line.startswith(name))
    return int(line.split()[1]) << 10


@contextlib.contextmanager
def _in_folder(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


@contextlib.contextmanager
def _environment(changes: Mapping[str, str]) -> Iterator[None]:
    before = dict(os.environ)
    os.environ.update(changes)
    try:
        yield
    finally:
        for name in changes:
            os.environ.pop(name, None)
        os.environ.update(before)


@contextlib.contextmanager
def _printing_to(folder: Path) -> Iterator[None]:
    """Send what Python and libraries print to files."""
    kept = [os.dup(1), os.dup(2)]
    for number, name in ((1, STDOUT), (2, STDERR)):
        opened = os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(opened, number)
        os.close(opened)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, duplicate in zip((1, 2), kept, strict=True):
            os.dup2(duplicate, number)
            os.close(duplicate)


if __name__ == "__main__":
    serve(int(sys.argv[1]), int(sys.argv[2]))

"""Where the program begins: what can fail before there is a command fails here, in one line."""

from __future__ import annotations

import sys

from ddic.cli.failed_start import failures_as_lines
from ddic.cli.surroundings import imports_kept, open_closed_streams
from ddic.parallel.stop_request import StopRequest


def main() -> None:
    """Run the command line."""
    open_closed_streams()
    stop = StopRequest()
    if sys.argv[1:2] == ["run"]:
        # Before the imports of a second or two, in which a rank that a signal ends would leave the others waiting.
        stop.note_signals()
    with failures_as_lines(), imports_kept():
        from ddic.cli.app import main as command_line

    command_line(prog_name="ddic", obj=stop)

"""What a launcher adds to what its ranks print."""

from __future__ import annotations

import re

_OF_LAUNCHER = re.compile(r"\[[^\]]+:\d+\] |(mpi\w+|\(null\)): (Forwarding signal |abort is already)|\[warn\] Epoll ")
"""Open MPI names host and process, or the launcher, which now and then is ``(null)``; libevent within it warns."""

_RULE = "-" * 40


def drop_launcher_lines(text: str) -> list[str]:
    """Keep the lines of the ranks.

    Parameters
    ----------
    text : str
        Standard error of ``mpiexec``.

    Returns
    -------
    list of str
        Without empty lines, the launcher's own, and paragraphs between dashes.
    """
    kept, quoted = [], False
    for line in text.splitlines():
        if line.startswith(_RULE):
            quoted = not quoted
        elif line.strip() and not quoted and not _OF_LAUNCHER.match(line):
            kept.append(line)
    return kept

"""Inputs that change while they are measured are told, whatever comes of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from ddic.errors import DdicError, InputError, as_collective, is_collective
from ddic.io.file_stamps import FileStamps
from ddic.parallel.team import Team


@contextmanager
def inputs_kept(team: Team, stamps: FileStamps) -> Iterator[None]:
    """Refuse what the block finds where its inputs were not the same from their check to its end; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    stamps : FileStamps
        Of the inputs when they were checked.

    Yields
    ------
    None
        While they are read.

    Raises
    ------
    InputError
        On all ranks, with a line for each file that has changed or vanished, in place of what the block raises.
    """
    try:
        yield
    except (DdicError, OSError) as error:
        if is_collective(error):
            _require_same(team, stamps, error)
        raise
    _require_same(team, stamps, None)


def _require_same(team: Team, stamps: FileStamps, error: Exception | None) -> None:
    changes = team.on_root(stamps.list_changes)
    if changes:
        raise as_collective(InputError(changes)) from error

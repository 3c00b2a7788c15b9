"""Errors as other ranks can receive them."""

from __future__ import annotations

import pickle
import traceback

from ddic.errors import DdicError


def make_portable(error: Exception, rank: int) -> Exception:
    """Make an error that other ranks can receive; an unexpected one brings its traceback along as a note.

    Parameters
    ----------
    error : Exception
        Of this rank.
    rank : int
        Its number.

    Returns
    -------
    Exception
        The same, or what says the same where it cannot be pickled.
    """
    if isinstance(error, DdicError):
        return error
    error.add_note(f"on rank {rank}:\n{''.join(traceback.format_exception(error))}")
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        # Some exceptions cannot be rebuilt from their arguments, which would end the other ranks without a reason.
        stand_in = RuntimeError(f"{type(error).__name__}: {error}")
        stand_in.__notes__ = error.__notes__
        return stand_in
    return error

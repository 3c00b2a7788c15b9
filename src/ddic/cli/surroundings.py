"""What every command takes for granted of the system: open streams, a clock, a folder to work in."""

from __future__ import annotations

import os
import sys
import time

from ddic.errors import DdicError, InputError


def open_closed_streams() -> None:
    """Open standard streams that are closed onto nothing; call it before any file is opened.

    Python has none in their place, and the next file would take the number of one: what libraries print would go into
    it.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            # The system gives the lowest number that is free, which is this stream's.
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def require_clock() -> None:
    """Refuse a clock beyond 2262, at whose nanoseconds Python's own modules fail when they are imported.

    Raises
    ------
    DdicError
        With what it needs.
    """
    try:
        time.time()
    except OverflowError as error:
        raise DdicError("the system's clock stands before 1678 or after 2261, of which Python cannot tell the time: "
                        "set it right (date)") from error


def require_working_folder() -> None:
    """Refuse to work in a folder that was deleted: neither names of files nor PETSc begin without it.

    Raises
    ------
    InputError
        With what to do.
    """
    try:
        os.getcwd()
    except OSError as error:
        raise InputError(f"the working directory cannot be found ({error.strerror}): it was deleted or closed; change "
                         "to another one") from error

"""What PETSc raises, as a line of the command line."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence

from ddic.errors import DdicError, InputError

OF_OPTIONS = (56, 60, 62, 63, 65, 67, 83, 86, 92)
"""PETSc's numbers of errors that a wrong option makes: not supported, wrong size, type, range or value, no such file or
kind, no such package."""


def is_petsc_error(error: BaseException) -> bool:
    """Tell whether an error is PETSc's.

    Parameters
    ----------
    error : exception
        Any.

    Returns
    -------
    bool
        False too where PETSc has not been imported.
    """
    petsc = sys.modules.get("petsc4py.PETSc")
    return petsc is not None and isinstance(error, petsc.Error)


def describe_petsc_error(error: BaseException, options: Sequence[str]) -> tuple[str, int]:
    """Say what PETSc refused, and whose fault it may be.

    Parameters
    ----------
    error : PETSc.Error
        As it was caught.
    options : sequence of str
        Of PETSc, as they were given on the command line.

    Returns
    -------
    line : str
        With its reason.
    exit_code : int
        That of a wrong input where options were given and the error is one that they make.
    """
    number = getattr(error, "ierr", None)
    said = [re.sub(r"^\[\d+\] ", "", line).strip() for line in str(error).splitlines()]
    reason = next((line for line in reversed(said) if line and " at " not in line), "no reason given")
    if options and number in OF_OPTIONS:
        return f"PETSc refuses its options {' '.join(options)}: {reason} (error {number})", InputError.exit_code
    return f"PETSc failed: {reason} (error {number})", DdicError.exit_code

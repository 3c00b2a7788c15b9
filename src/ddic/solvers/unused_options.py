"""Options of PETSc that were given and never asked for: mistyped ones, above all."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

from petsc4py import PETSc

from ddic.parallel.team import Team

ASKED_AT_THE_END = ("options_left", "options_view")
"""Options that PETSc itself looks at only when it ends."""


def list_unused_options(team: Team, words: Sequence[str]) -> list[str]:
    """List the options that no rank has asked for so far; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    words : sequence of str
        Options and their values as they were given on the command line.

    Returns
    -------
    list of str
        With their dash, in order.
    """
    names = [name for name in PETSc.Options().getAll() if f"-{name}" in words and name not in ASKED_AT_THE_END]
    used = set(team.gather_lists([name for name in names if _is_used(name)]))
    return [f"-{name}" for name in names if name not in used]


def _is_used(name: str) -> bool:
    """Whether PETSc has looked for an option; petsc4py does not say it, the library that it is linked with does."""
    ask = getattr(ctypes.CDLL(PETSc.__file__), "PetscOptionsUsed", None)
    if ask is None:
        # Where the library hides its names, nothing is known, and nobody is warned in vain.
        return True
    ask.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.POINTER(ctypes.c_int)]
    used = ctypes.c_int(0)
    ask(None, name.encode(), ctypes.byref(used))
    return bool(used.value)

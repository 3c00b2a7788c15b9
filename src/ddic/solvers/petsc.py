"""What ddic asks of PETSc beyond solving.

- Option prefixes and their defaults, in one place; the command line overrides them.
- Numbers as PETSc's integers, which have 32 bits in most builds.
- Memory that is freed goes back to the operating system.
- Which packages factorise what, where PETSc was built without CHOLMOD or MUMPS.
- Objects in the making: freed if their maker fails half-way, and all at once at the end.
- Options that were given and never asked for: mistyped ones, above all.
"""

import ctypes
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from ddic.errors import FactorizationError, InputError
from ddic.parallel.team import Team

LARGEST = int(np.iinfo(PETSc.IntType).max)
"""Largest of PETSc's integers: of rows, columns, and entries of a rank's part of a matrix."""


def to_petsc_integers(numbers: NDArray[Any], what: str) -> NDArray[Any]:
    """Convert numbers, not negative, to PETSc's integers; a plain cast would turn those that are too large into others.

    Raises FactorizationError where one is too large; ``what`` says in the message what is counted.
    """
    check_petsc_size(int(numbers.max(initial=0)), what)
    return numbers.astype(PETSc.IntType)


def check_petsc_size(size: int, what: str) -> None:
    """Check that a size, of ``what``, is one of PETSc's integers; raises FactorizationError where it is too large."""
    if size > LARGEST:
        raise FactorizationError(
            f"{what}: {size} is more than PETSc's {8 * np.dtype(PETSc.IntType).itemsize}-bit integers hold; start more "
            "ranks, give larger elements, or build PETSc with --with-64-bit-indices")


_TRIM_THRESHOLD, _MMAP_THRESHOLD, _MMAP_MAX = -1, -3, -4
"""Keys of the C library's mallopt."""

_LARGE = 2**22
"""Bytes from which an array is mapped: a larger value keeps more freed memory on the heap."""

_KEPT = 2**26
"""Freed bytes at the heap's end that stay with the process: a smaller value has the system clear the same pages again
for one array after the other, a twentieth of a large run; a larger one keeps more memory."""


def _release_freed_memory() -> None:
    """Undo what SuperLU_DIST, which PETSc may be linked with, does to the C library's malloc when it is loaded.

    It forbids mmap and trimming (M_MMAP_MAX = 0), so that a freed factor stays with the process, mostly in pieces
    too small for the next one. Arrays above 4 MiB are mapped again, hence given back when freed; smaller ones stay
    on the heap, where they are fast, the last 64 MiB of it also when freed. Nothing happens where the C library has
    no mallopt (only glibc's has an effect).
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for option, value in ((_MMAP_MAX, 65536), (_MMAP_THRESHOLD, _LARGE), (_TRIM_THRESHOLD, _KEPT)):
            mallopt(option, value)


PACKAGE = "pc_factor_mat_solver_type"
"""PETSc's option that names a package, behind the prefix of what is factorised."""

REPLICATED = {
    "ksp_type": "preonly",
    "ksp_error_if_not_converged": "true",
    "pc_type": "redundant",
    "redundant_ksp_type": "preonly",
    "redundant_pc_type": "cholesky",
    # Quasi-definite, hence factorised in any order: small pivots come from vectors that hardly differ, and are right.
    "redundant_pc_factor_zeropivot": "1e-20",
}
"""Options in place of a parallel factor: PETSc's own LDL^T of the whole matrix on every rank."""

WITH_CHOLMOD = ("suitesparse", "cholmod")
"""Names that say that PETSc has CHOLMOD: 3.18 goes by the collection, 3.26 by its members."""

LOCAL_FACTORS = ("dual", "monolithic")
"""Methods that factorise each subdomain's own operator."""


def has_package(name: str) -> bool:
    """Tell whether PETSc was built with a package, such as ``"suitesparse"``."""
    return bool(PETSc.Sys.hasExternalPackage(name))


def choose_local_package() -> str:
    """Choose what factorises on one rank, for ``pc_factor_mat_solver_type``: CHOLMOD, else MUMPS, else PETSc itself."""
    if any(has_package(name) for name in WITH_CHOLMOD):
        return "cholmod"
    return "mumps" if has_package("mumps") else "petsc"


def is_mumps_missing(prefix: str) -> bool:
    """Tell whether MUMPS is meant to factorise something, and PETSc lacks it; False where the user names a package."""
    return not has_package("mumps") and not PETSc.Options().hasName(prefix + PACKAGE)


def require_packages(where: str, method: str, local_inverse: str, n_ranks: int) -> None:
    """Refuse what PETSc cannot factorise without MUMPS: raises InputError where nothing takes its place.

    ``where`` is the case file, ``method`` and ``local_inverse`` are those of its ``solver``.
    """
    if method == "assembled" and n_ranks > 1 and is_mumps_missing("assembled_"):
        raise InputError(f'{where}: solver.method = "assembled" on {n_ranks} MPI ranks needs MUMPS, and PETSc was '
                         'built without it; use "conjugate_gradient" or "dual", start one rank, or build PETSc with '
                         "MUMPS (docs/installation.md)")
    # Left open, the method is the dual one where this key is given.
    if method in ("auto", "dual") and local_inverse == "sparse" and is_mumps_missing("inverse_"):
        raise InputError(f'{where}: solver.local_inverse = "sparse" needs MUMPS, and PETSc was built without it; use '
                         '"auto" or "dense", or build PETSc with MUMPS (docs/installation.md)')


def describe_missing_packages(method: str) -> tuple[str, ...]:
    """Say, a line for each package that PETSc lacks and ``solver.method`` would use, what takes its place."""
    lines = []
    chosen = choose_local_package()
    if (method in LOCAL_FACTORS and chosen != "cholmod"
            and PETSc.Options().getString("local_" + PACKAGE, chosen) == chosen):
        lines.append(f"PETSc was built without SuiteSparse: {chosen} factorises the operators in CHOLMOD's place")
    if method == "dual" and is_mumps_missing(COARSE_FACTOR):
        lines.append("PETSc was built without MUMPS: inverses of subdomains are arrays whatever their size, and a "
                     "coarse problem is factorised on every rank by PETSc itself")
    if method == "assembled" and is_mumps_missing("assembled_"):
        lines.append(f"PETSc was built without MUMPS: {chosen} factorises the operator in its place")
    return tuple(lines)


# At import, for PETSc's libraries change malloc when they are loaded, and assembly comes before the first solver.
_release_freed_memory()

LOCAL = "local_"
DUAL = "dual_"
COARSE = "coarse_"
COARSE_FACTOR = "coarse_telescope_"
"""The coarse matrix is factorised by some ranks, or by one; PETSc has this prefix follow that of who chooses them."""

INVERSE = "inverse_"
SCHUR = "schur_"
ASSEMBLED = "assembled_"
CONJUGATE_GRADIENT = "cg_"

_FACTOR = {"ksp_type": "preonly", "pc_type": "cholesky"}
_FACTOR_BY_MUMPS = {**_FACTOR, PACKAGE: "mumps"}
"""What all that is factorised begins with, and what MUMPS factorises unless the user says otherwise."""

DEFAULTS: dict[str, dict[str, str]] = {
    LOCAL: {
        **_FACTOR,
        "mat_cholmod_print": "0",
        # Operations an entry of the factor from which on it is made by dense blocks: below, of subdomains of some
        # hundred unknowns, these take longer (at 40, CHOLMOD's own, by a half); beyond, entry by entry takes longer.
        "mat_cholmod_supernodal_switch": "100",
    },
    COARSE: {"ksp_type": "preonly", "pc_type": "telescope"},
    COARSE_FACTOR: {
        **_FACTOR_BY_MUMPS,
        "ksp_error_if_not_converged": "true",
        # Room beyond MUMPS's estimate, in per cent: nearly dependent coarse vectors delay pivots.
        "mat_mumps_icntl_14": "100",
    },
    INVERSE: {
        **_FACTOR_BY_MUMPS,
        "ksp_error_if_not_converged": "true",
        # Room beyond MUMPS's estimate, in per cent: the zeros of D_s delay pivots, of small matrices most.
        "mat_mumps_icntl_14": "200",
        # Null pivots are counted: the inertia tells a singular interface problem.
        "mat_mumps_icntl_24": "1",
    },
    SCHUR: {**_FACTOR_BY_MUMPS, "ksp_error_if_not_converged": "true"},
    ASSEMBLED: _FACTOR_BY_MUMPS,
    CONJUGATE_GRADIENT: {
        "ksp_type": "cg",
        "ksp_norm_type": "preconditioned",
        "pc_type": "jacobi",
    },
    DUAL: {
        # Keeps what the preconditioner gave for each direction: its products in single precision cost no digit.
        "ksp_type": "fgmres",
        "ksp_pc_side": "right",
        "ksp_norm_type": "unpreconditioned",
        "ksp_gmres_modifiedgramschmidt": "",
    },
}


def create_ksp(comm: PETSc.Comm, prefix: str) -> PETSc.KSP:
    """Create a Krylov solver or factor with an option prefix and its defaults, where the user says nothing else.

    ``prefix`` is a key of ``DEFAULTS``. The caller sets operators and tolerances, then calls ``setFromOptions`` last,
    and destroys it in the end.
    """
    _set_defaults(prefix)
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix(prefix)
    return ksp


COARSE_UNKNOWNS = 2000
"""Unknowns of a coarse problem for each rank that factorises it: twice as many took 66 MiB of one rank. A larger number
makes fewer ranks do more, a smaller one send more."""


def create_coarse_ksp(comm: PETSc.Comm, n_unknowns: int) -> PETSc.KSP:
    """Create, as ``create_ksp``, what factorises a coarse problem, on as many ranks as its unknowns are worth."""
    n_ranks = min(comm.size, max(1, -(-n_unknowns // COARSE_UNKNOWNS)))
    step = comm.size // n_ranks
    if is_mumps_missing(COARSE_FACTOR):
        return create_ksp(comm, COARSE)
    if step == 1:
        return create_ksp(comm, COARSE_FACTOR)
    _set_defaults(COARSE_FACTOR)
    ksp = create_ksp(comm, COARSE)
    options, name = PETSc.Options(), f"{COARSE}pc_telescope_reduction_factor"
    is_given = options.hasName(name)
    if not is_given:
        options.setValue(name, step)
    ksp.setFromOptions()
    if not is_given:
        # That of another coarse problem may be another one.
        options.delValue(name)
    return ksp


def _set_defaults(prefix: str) -> None:
    options = PETSc.Options()
    for name, value in _choose_defaults(prefix).items():
        if not options.hasName(prefix + name):
            options.setValue(prefix + name, value)


def _choose_defaults(prefix: str) -> dict[str, str]:
    """The defaults of a prefix, as far as PETSc has the packages that they name."""
    defaults = DEFAULTS[prefix]
    if prefix == LOCAL:
        return defaults | {PACKAGE: choose_local_package()}
    if prefix == COARSE and is_mumps_missing(COARSE_FACTOR):
        return REPLICATED
    if defaults.get(PACKAGE) == "mumps" and is_mumps_missing(prefix):
        return defaults | {PACKAGE: choose_local_package()}
    return defaults


_LIBRARY = ctypes.CDLL(PETSc.__file__)
"""PETSc's own library, for what petsc4py does not offer."""


def can_eliminate() -> bool:
    """Tell whether ``eliminate`` is there: MUMPS does it, and the library that petsc4py loads shows its functions."""
    return has_package("mumps") and hasattr(_LIBRARY, "MatFactorSetSchurIS")


def eliminate(matrix: PETSc.Mat, n: int) -> NDArray[np.float64]:
    """Eliminate the first n unknowns of a symmetric matrix: the Schur complement of the others, an array.

    ``matrix`` is of type SBAIJ on this rank, with its upper triangle; MUMPS stops where the others begin.
    """
    size = matrix.getSize()[0]
    complement, values = ctypes.c_void_p(), ctypes.POINTER(ctypes.c_double)()
    with PetscStack() as stack:
        ksp = stack.keep(create_ksp(PETSc.COMM_SELF, SCHUR))
        ksp.setOperators(matrix)
        ksp.setFromOptions()
        ksp.getPC().setFactorSetUpSolverType()
        kept = stack.keep(PETSc.IS().createStride(size - n, first=n, step=1, comm=PETSc.COMM_SELF))
        factor = ctypes.c_void_p(ksp.getPC().getFactorMatrix().handle)
        _check(_LIBRARY.MatFactorSetSchurIS(factor, ctypes.c_void_p(kept.handle)))
        ksp.setUp()
        _check(_LIBRARY.MatFactorCreateSchurComplement(factor, ctypes.byref(complement), None))
        try:
            _check(_LIBRARY.MatDenseGetArray(complement, ctypes.byref(values)))
            # Both triangles hold it, the one to rounding as the other.
            below = np.tril(np.ctypeslib.as_array(values, shape=(size - n, size - n)))
        finally:
            _LIBRARY.MatDestroy(ctypes.byref(complement))
    whole: NDArray[np.float64] = below + np.tril(below, -1).T
    return whole


def _check(code: int) -> None:
    """Raise what PETSc's functions report by their number."""
    if code:
        raise PETSc.Error(code)


class _Destroyable(Protocol):
    """A PETSc object, or what holds some."""

    def destroy(self) -> object:
        """Free it."""


T = TypeVar("T", bound=_Destroyable)


class PetscStack(ExitStack):
    """Destroys what it keeps, last made first, when its ``with`` block ends."""

    def keep(self, thing: T) -> T:
        """Keep a thing, destroyed with the stack, and return it."""
        self.callback(thing.destroy)
        return thing


class PetscOwner:
    """Owns objects of PETSc's.

    Its constructor makes them inside a ``with PetscStack()``, so that an error on the way frees those already made, and
    ends with ``self._objects = stack.pop_all()``. Python's collector is not enough: it runs at different times on the
    ranks, so that petsc4py leaves parallel objects to a later clean-up.
    """

    _objects: PetscStack

    def destroy(self, _: object = None) -> None:
        """Free them, before the interpreter ends; PETSc calls it too, when the shell goes whose context this is."""
        self._objects.close()


ASKED_AT_THE_END = ("options_left", "options_view")
"""Options that PETSc itself looks at only when it ends."""


def list_unused_options(team: Team, words: Sequence[str]) -> list[str]:
    """List the options, with their dash, of the command line's words that no rank has asked for so far; collective."""
    names = [name for name in PETSc.Options().getAll() if f"-{name}" in words and name not in ASKED_AT_THE_END]
    used = set(team.gather_lists([name for name in names if _is_used(name)]))
    return [f"-{name}" for name in names if name not in used]


def _is_used(name: str) -> bool:
    """Whether PETSc has looked for an option; petsc4py does not say it, the library that it is linked with does."""
    ask = getattr(_LIBRARY, "PetscOptionsUsed", None)
    if ask is None:
        # Where the library hides its names, nothing is known, and nobody is warned in vain.
        return True
    ask.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.POINTER(ctypes.c_int)]
    used = ctypes.c_int(0)
    ask(None, name.encode(), ctypes.byref(used))
    return bool(used.value)

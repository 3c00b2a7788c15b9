"""Imports every module of ddic's serial layers while mpi4py and petsc4py cannot be imported."""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

SERIAL_LAYERS = (
    "errors",
    "images",
    "mesh",
    "kinematics",
    "functionals",
    "partition",
    "calibration",
    "case",
    "synth",
    "io",
)
FORBIDDEN = ("mpi4py", "petsc4py", "ddic.parallel")


def block(names: tuple[str, ...]) -> None:
    """Make the import of each name fail, as on a machine that lacks it."""
    # None in sys.modules is the import system's own way to say "not importable"; its annotation omits it.
    modules: dict[str, Any] = sys.modules
    modules.update(dict.fromkeys(names))


def modules_of(package: ModuleType) -> Iterator[str]:
    """Yield the package's name and the names of all modules below it."""
    yield package.__name__
    if hasattr(package, "__path__"):
        for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            yield info.name


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--numpy-major", type=int, help="fail unless numpy has this major version")
    arguments = parser.parse_args()
    block(FORBIDDEN)
    names = [
        name
        for layer in SERIAL_LAYERS
        for name in modules_of(importlib.import_module(f"ddic.{layer}"))
    ]
    for name in names:
        importlib.import_module(name)
    numpy = importlib.import_module("numpy")
    if arguments.numpy_major not in {None, int(numpy.__version__.split(".")[0])}:
        sys.exit(f"expected numpy {arguments.numpy_major}, found {numpy.__version__}")
    print(f"imported {len(names)} modules with numpy {numpy.__version__}")


if __name__ == "__main__":
    main()

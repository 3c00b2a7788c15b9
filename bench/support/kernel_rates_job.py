"""One checkout's pixel kernels, timed call by call as its standard input asks; started by ``bench/kernel_rates.py``.

Arguments: a mesh (.npz), the degree of the spline. Of one checkout or another: ``ddic`` is what PYTHONPATH says.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.images.binned import ArraySource
from ddic.images.spline import read_gradient, read_spline
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.mesh.mesh import Mesh


def find_functional() -> ModuleType:
    """The module that reads correlations: of some older checkouts one of its own."""
    try:
        return importlib.import_module("ddic.functionals.read_correlation")
    except ImportError:
        return importlib.import_module("ddic.functionals.correlation")


functional = find_functional()

LEAST_SECONDS = 0.03
"""CPU time of a measurement: a call is repeated until it takes as long. Longer is quieter."""

FORMER_NAMES = {
    "read_correlations": "correlations",
    "compute_cell_hessians": "hessian_cells",
    "compute_residual": "residual",
    "compute_residual_image": "residual_image",
    "find_displaced_window": "displaced_window",
    "get_spline": "covering",
}
"""What the functions of today were called in older checkouts."""


def of_any_checkout(owner: Any, name: str) -> Any:
    """A function by its name of today, or by its former one."""
    return getattr(owner, name) if hasattr(owner, name) else getattr(owner, FORMER_NAMES[name])


def displacement(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    """The reference field at nodes (n, 2), as unknowns (2 n,), pixels."""
    x, y = 2 * np.pi * nodes.T
    along_x = 0.35 + 0.60 * np.sin(x / 1024 + 0.3) * np.cos(y / 1280 - 0.2)
    along_y = -0.25 + 0.50 * np.cos(x / 1280 - 0.7) * np.sin(y / 1024 + 0.5)
    return np.column_stack([along_x, along_y]).ravel()


def calls_on(mesh: Mesh, degree: int) -> dict[str, Callable[[], Any]]:
    """What is timed on a mesh, by name."""
    side = int(np.ceil(mesh.nodes.max())) + 32
    pixels = np.random.default_rng(0).integers(0, 256, (side, side), dtype=np.uint8)
    source = MaskedSource(ArraySource(Path("memory"), pixels, 255.0))
    part = of_any_checkout(functional, "read_correlations")([mesh], source, degree)[0][0]
    deformed = DeformedSubImage(source, degree)
    q = displacement(mesh.nodes)
    window = of_any_checkout(part, "find_displaced_window")(q)
    of_any_checkout(deformed, "get_spline")(window)
    hessians = of_any_checkout(part, "compute_cell_hessians")
    residual = of_any_checkout(part, "compute_residual")
    image = of_any_checkout(part, "compute_residual_image")

    def sums(all_kinds: bool) -> list[NDArray[np.float64]]:
        found = residual(deformed, q, all_kinds=all_kinds)
        return [found.moments, found.cell_sums.values]

    def gradient() -> list[NDArray[np.float32]]:
        found: Any = read_gradient(source.image, part.reference.window, degree)
        slopes = found.slopes if hasattr(found, "slopes") else (found.by_x, found.by_y)
        return [found.values, *slopes]

    return {
        "M_e": lambda: [hessians()],
        "residual sums": lambda: sums(False),
        "residual sums for a grey correction": lambda: sums(True),
        "residual image": lambda: [image(deformed, q)],
        "gradient of f": gradient,
        "prefilter of g": lambda: [read_spline(source.image, window, degree).coefficients],
    }


def digest_of(arrays: list[NDArray[Any]]) -> str:
    """The same for the same bits."""
    return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()


def seconds_of(call: Callable[[], Any], n_calls: int) -> float:
    """CPU seconds of one call, a mean over some."""
    began = time.process_time()
    for _ in range(n_calls):
        call()
    return (time.process_time() - began) / n_calls


def main() -> None:
    """Say what comes of each call, then time those that are named, a line each."""
    stored = np.load(sys.argv[1])
    mesh = Mesh(stored["nodes"], stored["connectivity"], stored["offsets"], stored["types"])
    calls = calls_on(mesh, int(sys.argv[2]))
    digests = {name: digest_of(call()) for name, call in calls.items()}
    n_calls = {name: max(1, round(LEAST_SECONDS / seconds_of(call, 1))) for name, call in calls.items()}
    print(json.dumps(digests), flush=True)
    for line in sys.stdin:
        name = line.strip()
        print(seconds_of(calls[name], n_calls[name]), flush=True)


if __name__ == "__main__":
    main()

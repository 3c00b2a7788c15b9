"""Voxel kernels, one core: residual and right-hand side, Hessians, prefilter; cubes of 256 voxels, 8 bit.

All are measured alternately in one process; rates are medians of CPU time and count the region's voxels.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.kernels import alternated
from bench.support.rows import Row, append_result, main
from ddic.functionals.correlation import read_correlation
from ddic.images.binned import ArraySource
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.images.volume import read_coefficients
from ddic.mesh.cell_type import HEX8, TET4
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh, build_mesh

SIZE, SMALL, MARGIN, ELEMENT = 256, 80, 16, 16
"""Side of the cube, SMALL to see that everything runs; edge without elements, side of the elements, voxels."""

WARP = 1.0
"""By which nodes of warped boxes are moved at random along each axis, voxels."""

SIX = np.array([[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]])
"""Tetrahedra of a box, by its corners."""

LEAST = {"prefilter": 300, "residual, Hex8": 140, "residual, warped Hex8": 50, "residual, Tet4": 60,
         "Hessians, Hex8": 80}
"""Million voxels a second of a core; others are recorded."""


def build_meshes(size: int) -> dict[str, Mesh]:
    """Build the same region of boxes, of warped ones, and of tetrahedra."""
    boxes = GridLines((np.arange(MARGIN, size - MARGIN + 1.0, ELEMENT),) * 3).build_mesh()
    moves = np.random.default_rng(1).uniform(-WARP, WARP, boxes.nodes.shape)
    return {"Hex8": boxes, "warped Hex8": build_mesh(boxes.nodes + moves, {HEX8: boxes.cells}),
            "Tet4": build_mesh(boxes.nodes, {TET4: boxes.cells[:, SIX].reshape(-1, 4)})}


def displace(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smooth waves at nodes (n, 3), as unknowns (3 n,), voxels."""
    waves = 0.6 * np.sin(2 * np.pi * nodes[:, [1, 2, 0]] / 128 + 0.3)
    return np.asarray(waves + np.array([0.35, -0.25, 0.4])).ravel()


def measure(size: int = SIZE) -> list[Row]:
    """Measure all kernels on all meshes."""
    voxels = np.random.default_rng(0).integers(0, 256, (size,) * 3, dtype=np.uint8)
    source = MaskedSource(ArraySource(Path("memory"), voxels, 255.0))
    calls: dict[str, Callable[[], object]] = {"prefilter": lambda: read_coefficients(source.image, source.extent)}
    counts = {"prefilter": voxels.size}
    for name, mesh in build_meshes(size).items():
        part, deformed, q = read_correlation(mesh, source, 3), DeformedSubImage(source, 3), displace(mesh.nodes)
        calls[f"residual, {name}"] = lambda part=part, g=deformed, q=q: part.compute_residual(g, q)  # type: ignore[misc]
        calls[f"Hessians, {name}"] = part.compute_cell_hessians
        counts |= dict.fromkeys((f"residual, {name}", f"Hessians, {name}"), part.n_usable_pixels)
    rates = {name: counts[name] / seconds / 1e6 for name, seconds in alternated(calls).items()}
    append_result("volume_kernels", {"size": size, **rates})
    return [Row(f"{name}, {size}^3, 8 bit", f">= {LEAST[name]} Mvoxel/s per core" if name in LEAST else "recorded",
                f"{rate:.0f} Mvoxel/s", rate >= LEAST.get(name, 0), judged_small=False)
            for name, rate in rates.items()]


if __name__ == "__main__":
    main("volume_kernels_rows", measure)

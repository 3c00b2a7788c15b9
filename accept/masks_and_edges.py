"""Right numbers whatever lies under a mask, at every cut-off wavelength and up to the image's edge."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

import ddic
from accept.support.settings import MONOLITHIC, describe_settings
from accept.table import Scale
from bench.support.rows import Row
from bench.support.runs import ddic_run, images
from ddic.functionals.correlation import read_correlation
from ddic.functionals.regularization import (
    Material,
    assemble_stiffness,
    evaluate_plane_waves,
    find_cut_off_weight,
    find_half_amplitudes,
    measure_gap_energies,
    measure_texture_energies,
)
from ddic.images.binned import ArraySource
from ddic.images.sub_image import MaskedSource
from ddic.io.result_reader import read_result
from ddic.mesh.structured import build_structured_mesh
from ddic.mesh.topology import find_boundary_nodes
from ddic.synth.truth import load_truth

Image = NDArray[np.uint8]

RING_PX, NODE_PX = 1e-4, 2e-3
"""RMS difference that garbage under a mask may make beside it, and the largest one at any node of the mesh."""

HALF_WITHIN = 0.05
"""Share of the wavelength that is printed within which a wave keeps half of its amplitude."""

EDGE_PX = 0.02
"""RMS error of a region as large as the image: noise of 1 grey level on elements of 16 px, and bilinear elements."""


def measure_masks(scale: Scale) -> list[Row]:
    """Put garbage, zeros and saturation under masks of f and g, without regularization."""
    side = 200 if scale.smoke else 512
    reference, deformed = ddic.make_synthetic_pair(_wave, (side, side), noise=1.0, seed=5)
    masks = np.ones((2, side, side), dtype=bool)
    low, high = side // 4, side // 2
    masks[0, low:high, low:high] = False
    masks[1, high:high + 20, low:high] = False
    mesh = ddic.structured_mesh((20, 20, side - 20, side - 20), 16)
    # Cells without a pixel need mechanics; their nodes lie inside the mask.
    options: dict[str, Any] = {**MONOLITHIC, "regularization": {"cut_off_wavelength": 48}}
    fields = {}
    noise = np.random.default_rng(1).integers(0, 256, reference.shape, dtype=np.uint8)
    under: dict[str, Image | int | None] = {"nothing": None, "garbage": noise, "zeros": 0, "saturation": 255}
    for name, garbage in under.items():
        pair = [_spoil(image, mask, garbage) for image, mask in zip((reference, deformed), masks, strict=True)]
        given = [ddic.Image(image, mask) for image, mask in zip(pair, masks, strict=True)]
        fields[name] = ddic.measure(given, mesh, **options).displacement
    distance = np.abs(mesh.nodes - (low + high) / 2).max(axis=1) - (high - low) / 2
    ring = (distance > -8) & (distance < 40)
    made = {name: np.linalg.norm(field - fields["nothing"], axis=1)
            for name, field in fields.items() if name != "nothing"}
    rms = {name: float(np.sqrt((length[ring] ** 2).mean())) for name, length in made.items()}
    largest = max(float(length.max()) for length in made.values())
    listed = ", ".join(f"{name} {value:.1e} px" for name, value in rms.items())
    return [Row("garbage, zeros and saturation under masks of f and g beside the same pair without, "
                f"{describe_settings(options)}: RMS in the ring about the mask, and largest at any node",
                f"<= {RING_PX} px, and {NODE_PX} px",
                f"{listed}; largest {largest:.1e} px", max(rms.values()) <= RING_PX and largest <= NODE_PX)]


def _wave(points: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y = points.T
    return np.column_stack([0.5 * np.sin(x / 60), 0.4 * np.cos(y / 70)])


def _spoil(image: Image, mask: NDArray[np.bool_], garbage: Image | int | None) -> Image:
    return image if garbage is None else np.where(mask, image, garbage).astype(np.uint8)


def measure_half_amplitudes(scale: Scale) -> list[Row]:
    """Find the waves of which one linear step keeps half, beside those that are printed."""
    side, wavelengths = (300, (40.0,)) if scale.smoke else (1400, (60.0, 100.0, 160.0))
    return [_compare_half_amplitudes(side, wavelength) for wavelength in wavelengths]


@cache
def _speckled_region(side: int) -> tuple[ddic.Mesh, sparse.csr_matrix]:
    mesh = build_structured_mesh((10, 10, 10 + side, 10 + side), 10)
    speckle, _ = ddic.make_synthetic_pair(np.zeros_like, (side + 20, side + 20), seed=1)
    image = ArraySource(Path("memory"), speckle.astype(np.float32))
    return mesh, read_correlation(mesh, MaskedSource(image), 3).assemble_hessian()


def _compare_half_amplitudes(side: int, wavelength: float) -> Row:
    mesh, hessian = _speckled_region(side)
    material, interior = Material(), np.ones(mesh.n_nodes, dtype=bool)
    interior[find_boundary_nodes(mesh)] = False
    eta = find_cut_off_weight(measure_texture_energies(mesh.nodes, hessian, interior, wavelength),
                              measure_gap_energies(mesh, material, interior, wavelength))
    kbar = sparse.diags(np.repeat(interior, 2).astype(float)) @ assemble_stiffness(mesh, material)
    operator = splu((hessian + eta * (kbar.T @ kbar)).tocsc())
    middle = np.repeat((np.abs(mesh.nodes - 10 - side / 2) < side / 4).all(axis=1), 2)

    def keep(columns: tuple[int, ...], length: float) -> float:
        waves = evaluate_plane_waves(mesh.nodes, length)[:, columns]
        return float((operator.solve(hessian @ waves) * waves)[middle].sum() / (waves**2)[middle].sum())

    told = find_half_amplitudes(material, wavelength)
    found = {"shear": (_halve(keep, (2, 3, 4, 5), told.shear), told.shear),
             "longitudinal": (_halve(keep, (0, 1, 6, 7), told.longitudinal), told.longitudinal)}
    listed = ", ".join(f"{name} {measured:.1f} px, printed {printed:.1f} px"
                       for name, (measured, printed) in found.items())
    return Row(f"half-amplitude wavelengths, l_c = {wavelength:g} px", f"within {HALF_WITHIN:.0%} of what is printed",
               listed, all(abs(measured / printed - 1) <= HALF_WITHIN for measured, printed in found.values()))


def _halve(keep: Callable[[tuple[int, ...], float], float], columns: tuple[int, ...], guess: float) -> float:
    """Bisect for the length of which half is kept."""
    short, long = 0.6 * guess, 1.6 * guess
    for _ in range(10):
        middle = (short + long) / 2
        short, long = (middle, long) if keep(columns, middle) < 0.5 else (short, middle)
    return (short + long) / 2


def measure_edges(scale: Scale) -> list[Row]:
    """Measure regions as large as the image, of sizes that no block divides, by the command line."""
    rows = []
    for width, height in ((201, 203),) if scale.smoke else ((871, 2050), (1001, 1001)):
        folder = images("sinusoidal", "--size", f"{width}x{height}", "--noise", "1",
                        folder=scale.folder("right") / f"edge_{width}x{height}" / "images")
        case = (f'[images]\nreference = "images/reference.tif"\ndeformed = "images/deformed.tif"\n'
                f"[mesh.structured]\nregion = [0, 0, {width - 1}, {height - 1}]\nelement_size = 16\n"
                '[regularization]\ncut_off_wavelength = 64\n[solver]\nmethod = "conjugate_gradient"\n')
        ddic_run(case, folder.parent, 2)
        result = read_result(folder.parent / "result.vtkhdf")
        error = result.displacement - load_truth(folder / "truth.json").displacement(result.mesh.nodes)
        rms = float(np.sqrt((error**2).sum(axis=1).mean()))
        rows.append(Row(f"a region as large as the image, {width} x {height} px, l_c = 64 px, method = "
                        '"conjugate_gradient": RMS error',
                        f"measured; <= {EDGE_PX} px", f"{rms:.4f} px", rms <= EDGE_PX))
    return rows

"""Case files on generated pairs, and what a run tells."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import tifffile

from ddic.parallel.phases import Phase
from ddic.problem.weighted_problem import ProblemSize
from ddic.separated.corrections import CorrectionRecord
from ddic.solvers.gauss_newton import IterationRecord
from ddic.synth.fields import DisplacementField, Sinusoidal
from support.pictures import pair_of

WAVES = Sinusoidal((0.3, -0.2), (0.5, 0.4), (256.0, 320.0), (320.0, 256.0))
REGION = "region = [24, 24, 168, 168]"


def write_images(folder: Path, displacement: DisplacementField = WAVES, side: int = 192) -> None:
    """Write f.tif and g.tif, 8 bit."""
    pair = pair_of(displacement, side, 8)
    tifffile.imwrite(folder / "f.tif", pair.reference)
    tifffile.imwrite(folder / "g.tif", pair.deformed)


def case_text(more: str = "", *, region: str = REGION, deformed: str = "g.tif", images: str = "") -> str:
    """A case on these images with 9 x 9 cells; more: further sections; images: further lines of [images]."""
    return (f'[images]\nreference = "f.tif"\ndeformed = "{deformed}"\n{images}\n'
            f"[mesh.structured]\n{region}\nelement_size = 16\n{more}\n")


def write_case(folder: Path, more: str = "", **sections: str) -> Path:
    """Write case.toml beside the images."""
    path = folder / "case.toml"
    path.write_text(case_text(more, **sections), encoding="utf-8")
    return path


@dataclass
class Ears:
    """A listener that keeps what it is told."""

    phases: list[str] = field(default_factory=list)
    shares: list[tuple[str, float]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    sizes: list[ProblemSize] = field(default_factory=list)
    records: list[IterationRecord] = field(default_factory=list)
    corrections: list[CorrectionRecord] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)

    def phase(self, phase: Phase) -> None:
        self.phases.append(phase)

    def progress(self, share: float) -> None:
        self.shares.append((self.phases[-1], share))

    def note(self, line: str) -> None:
        self.notes.append(line)

    def frame(self, number: int, n_frames: int, image: str) -> None:
        self.frames.append(number)

    def problem_size(self, size: ProblemSize) -> None:
        self.sizes.append(size)

    def iteration(self, record: IterationRecord) -> None:
        self.records.append(record)

    def correction(self, record: CorrectionRecord) -> None:
        self.corrections.append(record)


def contents(path: Path) -> dict[str, Any]:
    """All datasets of an HDF5 file by name, and all attributes by group@name."""
    found: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        found.update({f"{name}@{key}": value for key, value in item.attrs.items()})
        if isinstance(item, h5py.Dataset):
            found[name] = item[...]

    with h5py.File(path) as file:
        visit("", file)
        file.visititems(visit)
    return found


def largest_difference(a: np.ndarray, b: np.ndarray) -> float:
    """Largest absolute difference; NaN must be in the same places."""
    assert a.shape == b.shape
    np.testing.assert_array_equal(np.isnan(a), np.isnan(b))
    return float(np.nanmax(np.abs(a - b), initial=0.0))

"""A pair of PNG files measured on several ranks."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from mpi4py import MPI

from ddic.parallel.team import Team
from support.cases import write_case, write_images
from support.measuring import measure

RANKS = [1, 3]
MORE = "[regularization]\ncut_off_wavelength = 48.0\n[solver]\nsubdomains = 4\n"


@pytest.mark.parallel(RANKS)
def test_png_gives_the_field_of_tiff_with_two_decodings(shared_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    team = Team(MPI.COMM_WORLD)
    if team.is_root:
        write_images(shared_path)
        for name in ("f", "g"):
            cv2.imwrite(str(shared_path / f"{name}.png"), tifffile.imread(shared_path / f"{name}.tif"))
        write_case(shared_path, MORE)
        text = (shared_path / "case.toml").read_text()
        (shared_path / "png.toml").write_text(text.replace(".tif", ".png"))
    team.comm.barrier()
    decoded = []
    monkeypatch.setattr(cv2, "imread", lambda *a, read=cv2.imread: decoded.append(Path(a[0]).name) or read(*a))
    fields = [measure(team, shared_path / name).q for name in ("case.toml", "png.toml")]
    assert sorted(team.gather_lists(decoded)) == ["f.png", "g.png"]
    for tiff, png in zip(*fields, strict=True):
        # The same pixels and the same operations; only PETSc's dot products may be summed differently.
        np.testing.assert_allclose(png, tiff, rtol=0, atol=1e-9)

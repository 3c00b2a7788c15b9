"""A series whose reference image is updated: fields stay those since the first image, and what is added up is told."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import tifffile
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.case.loader import load_case
from ddic.errors import ConvergenceError, InputError
from ddic.io.series_reader import SeriesResult, read_series
from ddic.methods.run import run_file
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.results.summary import SeriesSummary
from ddic.synth.fields import Sinusoidal
from ddic.synth.render import Digitiser, Picture, Scene, render_pair
from ddic.synth.speckle import SpeckleTexture
from support.cases import Ears, write_case, write_images
from support.interrupted import assert_equal_results, interrupt

RANKS = [1, 3]
N_FRAMES = 4
SERIES = ", ".join(f'"g_{number}.tif"' for number in range(1, N_FRAMES + 1))
SOLVER = '[solver]\nmethod = "dual"\nsubdomains = 4\n'
NEVER, AUTO, ALWAYS = (f'incremental = "{when}"' for when in ("never", "auto", "always"))
SMOOTH = "[regularization]\ncut_off_wavelength = 48\n[gauss_newton]\nmax_iterations = 30\n"


def field(number: float) -> Sinusoidal:
    """Six pixels of translation a frame, and waves that grow."""
    return Sinusoidal((6.0 * number, -2.0 * number), (0.5 * number, 0.4 * number), (256.0, 320.0), (320.0, 256.0))


@cache
def render(number: int, seed: int) -> NDArray[np.float64]:
    pair = render_pair(Scene(SpeckleTexture(seed), field(number)), Picture(192, 192, Digitiser(8)))
    return (pair.deformed if number else pair.reference).astype(np.float64)


def write_frames(folder: Path, series: str, more: str = "", *, fades: bool = False) -> Path:
    """A case with its images, whose speckle turns into another one where it fades; collective."""
    if MPI.COMM_WORLD.rank == 0:
        folder.mkdir(exist_ok=True)
        write_images(folder)
        for number in range(N_FRAMES + 1):
            share = 0.2 * number if fades else 0.0
            values = (1.0 - share) * render(number, 3) + share * render(number, 5)
            name = f"g_{number}.tif" if number else "f.tif"
            tifffile.imwrite(folder / name, np.rint(values).astype(np.uint8))
        more = f"{SOLVER}{more}[series]\n{series}\n"
        text = write_case(folder, more, region="region = [24, 40, 136, 152]").read_text(encoding="utf-8")
        (folder / "case.toml").write_text(text.replace('deformed = "g.tif"', f"deformed = [{SERIES}]"),
                                          encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    return folder / "case.toml"


def run(path: Path, *, resume: bool = False) -> SeriesSummary:
    summary = run_file(Team.world(), path, Silence(), resume=resume)
    assert isinstance(summary, SeriesSummary)
    MPI.COMM_WORLD.barrier()
    return summary


def find_errors(series: SeriesResult, step: int) -> NDArray[np.float64]:
    found = series[step]
    return found.displacement - field(step + 1).displacement(found.mesh.nodes)


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("more", "of_frame"), [
    # Rounding to 8 bits on elements of 16 px.
    ("", 0.03),
    # Mechanics of 48 px flatten waves of 320 px, which grow by 0.5 px a frame.
    (SMOOTH, 0.06),
], ids=["plain", "smooth"])
def test_fields_are_those_since_the_first_image(shared_path: Path, more: str, of_frame: float) -> None:
    summary = run(write_frames(shared_path / "every", ALWAYS, more))
    assert [frame.reference for frame in summary.frames] == [0, 1, 2, 3]
    floors = [frame.noise_floor_px for frame in summary.frames]
    assert all(later > earlier for earlier, later in pairwise(floors))
    series = read_series(shared_path / "every" / "result.vtkhdf")
    first = series[0].mesh
    for step in range(N_FRAMES):
        # The mesh in the file is that of the first image, to the last bit.
        np.testing.assert_array_equal(series[step].mesh.nodes, first.nodes)
        assert series[step].attributes["provenance"]["reference_path"].endswith("f.tif")
        assert np.abs(find_errors(series, step)).max() < of_frame * (step + 1)


@pytest.mark.parallel([1, 3])
def test_speckle_that_changes_asks_for_it(shared_path: Path) -> None:
    with pytest.raises(ConvergenceError, match="frame 4: not measured"):
        run(write_frames(shared_path / "never", NEVER, SMOOTH, fades=True))
    MPI.COMM_WORLD.barrier()
    ears = Ears()
    path = write_frames(shared_path / "auto", AUTO, SMOOTH, fades=True)
    summary = run_file(Team.world(), path, ears)
    assert isinstance(summary, SeriesSummary)
    MPI.COMM_WORLD.barrier()
    assert [frame.reference for frame in summary.frames] == [0, 1, 2, 3]
    assert "frame 3 is the reference image from here on; its error adds up to those that follow" in ears.notes
    series = read_series(path.parent / "result.vtkhdf")
    for step in range(N_FRAMES):
        # A fifth of other speckle is grey levels of 11 that pull by 0.15 px (RMS); the same ones in every frame.
        assert np.sqrt((find_errors(series, step)**2).mean()) < 0.2 * (step + 1)


def test_a_residual_that_stays_asks_for_nothing(tmp_path: Path) -> None:
    summary = run(write_frames(tmp_path / "auto", AUTO))
    assert [frame.reference for frame in summary.frames] == [0, 0, 0, 0]


@pytest.mark.parallel(RANKS)
def test_what_is_resumed_equals_what_was_not_interrupted(shared_path: Path) -> None:
    whole, parts = (write_frames(shared_path / name, f"{ALWAYS}\nupdate_after = 2") for name in ("whole", "parts"))
    assert [frame.reference for frame in run(whole).frames] == [0, 0, 2, 2]
    interrupt(parts, 4)
    assert run(parts, resume=True).n_resumed == 3
    assert_equal_results(whole.parent / "result.vtkhdf", parts.parent / "result.vtkhdf")


def test_a_mesh_that_leaves_the_image_stays_with_its_reference(tmp_path: Path) -> None:
    path = write_frames(tmp_path / "out", ALWAYS)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("[24, 40, 136, 152]", "[72, 40, 184, 152]"), encoding="utf-8")
    ears = Ears()
    # The last columns of elements leave the image, and are excluded.
    summary = run_file(Team.alone(), path, ears)
    assert isinstance(summary, SeriesSummary)
    assert [frame.reference for frame in summary.frames][:2] == [0, 1]
    assert any("cannot be the reference image: the mesh lies outside the image" in note for note in ears.notes)


@pytest.mark.parametrize(("more", "reason"), [
    ('[output]\nresidual_image = true\nfile = "r.vtkhdf"\n', "leave output.residual_image out"),
    ('[output]\nuncertainty = true\nfile = "r.vtkhdf"\n', "leave output.uncertainty out"),
    ("update_after = 2\n", "goes with series.incremental = \"always\""),
    ("[[discontinuity]]\nvertices = [[0, 90], [90, 92]]\n", r"leave \[\[discontinuity\]\] out"),
], ids=["residual", "uncertainty", "idle", "line"])
def test_what_does_not_go_with_it_is_refused(tmp_path: Path, more: str, reason: str) -> None:
    path = write_frames(tmp_path / "case", AUTO)
    with path.open("a", encoding="utf-8") as file:
        file.write(more)
    with pytest.raises(InputError, match=rf"series\..*{reason}"):
        load_case(path)

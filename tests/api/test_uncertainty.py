"""Known displacements of one's own image, measured with both kinds of elements."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import ddic
from ddic.cli.studies import uncertainty
from ddic.errors import InputError

IMAGE, _ = ddic.make_synthetic_pair(np.zeros_like, (220, 200), seed=4)


def test_enriched_elements_hold_jumps_and_cost_little() -> None:
    found = ddic.estimate_uncertainty(IMAGE, element_sizes=(16, 32), n_amplitudes=3)
    continuous, enriched = np.moveaxis(found.deviation["discontinuous"][:, 1:], -1, 0)
    # Half of the jump is smeared over two elements: some hundredths of a pixel RMS; splines err by thousandths.
    assert (continuous > 5 * enriched).all()
    assert np.diff(continuous.mean(axis=1)) > 0
    of_uniform = found.deviation["uniform"]
    assert (of_uniform < 0.01).all()
    assert (of_uniform[..., 1] < 1.5 * of_uniform[..., 0] + 1e-4).all()
    # Nothing moved, and no noise: nothing but rounding is measured.
    assert (of_uniform[:, 0] < 1e-6).all()
    assert found.amplitudes.tolist() == [0.0, 0.5, 1.0]


def test_lines_that_can_only_open_are_opened_and_segments_go_on() -> None:
    segment = [[60.0, 95.3], [120.0, 101.1]]
    found = ddic.estimate_uncertainty(IMAGE, element_sizes=(16,), n_amplitudes=2,
                                     discontinuity=[{"vertices": segment, "opening": "normal"}])
    continuous, enriched = found.deviation["discontinuous"][0, 1]
    assert continuous > 5 * enriched


def test_more_noise_than_the_image_shows_is_refused() -> None:
    with pytest.raises(InputError, match=r"noise: 1e\+308, but grey levels of the image span"):
        ddic.estimate_uncertainty(IMAGE, element_sizes=(16,), n_amplitudes=2, noise=1e308)


def test_noise_is_what_is_measured_of_it() -> None:
    found = ddic.estimate_uncertainty(IMAGE, element_sizes=(16, 32), n_amplitudes=2, noise=2.0)
    rising = found.deviation["uniform"].mean(axis=1)
    assert (rising[0] > 1.5 * rising[1]).all()
    # At nodes it is larger than all over the elements, where shape functions average it; edges have more of it.
    ratio = found.predicted_noise / rising
    assert ((ratio > 1.0) & (ratio < 2.0)).all()
    assert (found.predicted_noise[:, 1] > found.predicted_noise[:, 0]).all()


@pytest.mark.parametrize(("image", "sizes", "message"), [
    (IMAGE[None], (16,), "give grey levels"),
    (IMAGE, (500,), "give sizes from 2 to"),
    (IMAGE, (), "give sizes from 2 to"),
])
def test_wrong_images_and_sizes_are_refused(image: np.ndarray, sizes: tuple[int, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        ddic.estimate_uncertainty(image, element_sizes=sizes)


@pytest.mark.parametrize(("sections", "message"), [
    ({"sizes": (16,)}, "sizes: unknown argument; valid here: element_sizes"),
    ({"mesh": {}}, "mesh: unknown argument"),
    ({"solver": {"method": "fast"}}, 'solver.method = "fast": expected'),
])
def test_wrong_sections_are_refused(sections: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        ddic.estimate_uncertainty(IMAGE, **sections)


def test_command_writes_a_table_and_a_figure(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "f.tif"), IMAGE)
    case = tmp_path / "case.toml"
    case.write_text('[images]\nreference = "f.tif"\ndeformed = "f.tif"\n[mesh.structured]\n'
                    'region = [16, 16, 180, 180]\nelement_size = 16\n[[discontinuity]]\n'
                    'vertices = [[-10, 90.3], [230, 100.2]]\n')
    told = CliRunner().invoke(uncertainty, [str(case), "--sizes", "32", "--displacements", "2"])
    assert told.exit_code == 0, told.output
    rows = np.genfromtxt(tmp_path / "case.uncertainty.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert len(rows) == 2 * 1 * 2 * 2
    assert (tmp_path / "case.uncertainty.png").stat().st_size > 10000
    refused = CliRunner().invoke(uncertainty, [str(case), "--sizes", "a,b"])
    assert refused.exit_code == 2
    assert refused.output.count("\n") == 1

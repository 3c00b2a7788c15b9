"""The report of a result: what it states, what it says is missing, and what a browser makes of it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import ddic
from accept.report_page import (
    LEAST_LIKENESS,
    find_clipped_texts,
    find_smallest_type,
    probe_page,
    show_page,
)
from accept.support.browser import find_browser
from ddic.case.schema import AcquisitionSection
from ddic.cli.info import report
from ddic.errors import ConvergenceError
from ddic.images.binned import BLUR_NOTE
from ddic.images.grey_levels import measure_feature_size
from ddic.io.image_file import open_image
from ddic.io.result_reader import read_result
from ddic.io.series_reader import read_series
from ddic.report.items import (
    NOT_RECORDED,
    NOT_STATED,
    OF_SETUP,
    find_worst_places,
    gather_all,
    list_statements,
)
from ddic.report.page import draw_report_figures, write_report
from support.commands import ddic as run_command
from support.series_files import FrameFile, write_series_file

CASE = """
title = "a <strip> & its hole"
[images]
reference = "images/reference.tif"
deformed = "images/deformed.tif"
pixel_size = 0.0125
length_unit = "mm"
[mesh.structured]
region = [12, 12, 188, 188]
element_size = 11
circles = [{ center = [99.5, 99.5], radius = 25 }]
[regularization]
cut_off_wavelength = 40
[solver]
method = "dual"
subdomains = 4
[acquisition]
camera = "a camera of 12 bits"
lens = "f = 100 mm"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plate with a hole, measured by the command line."""
    path = tmp_path_factory.mktemp("report")
    made = run_command("synth", "kirsch", "--size", "200x200", "--strain", "0.005", "--radius", "25", "--noise", "2",
                       "--output", path / "images")
    assert made.code == 0, made.err
    (path / "case.toml").write_text(CASE)
    ran = run_command("run", path / "case.toml")
    assert ran.code == 0, ran.err
    return path


def state(path: Path) -> dict[str, str]:
    """All that a report states, by its name."""
    statements = list_statements(gather_all(read_result(path)))
    return {name: value for items in statements.values() for name, value in items}


def write(folder: Path, *arguments: str) -> str:
    page = folder / "page.html"
    ran = CliRunner().invoke(report, [str(folder / "result.vtkhdf"), "--output", str(page), *arguments])
    assert ran.exit_code == 0, ran.output
    return page.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(folder: Path) -> Path:
    """The report of the plate, beside its result."""
    write(folder)
    return folder / "page.html"


def test_what_is_stated(folder: Path) -> None:
    stated = state(folder / "result.vtkhdf")
    assert stated["Camera"] == "a camera of 12 bits"
    assert stated["Aperture"] == f"{NOT_STATED}: acquisition.aperture"
    assert stated["Image processing before ddic"] == f"{NOT_STATED}: acquisition.processing"
    assert stated["Image filtering by ddic"] == "none but the interpolating spline"
    # Elements of 11 px: two about a node, and those that its outer nodes take part in.
    assert stated["Strain window"].startswith("the elements around a node, 22 px across; held by pixels over 44 px")
    assert stated["Image scale"] == "0.0125 mm per px (80 px per mm)"
    assert stated["Field of view"] == "2.5 mm x 2.5 mm"
    assert stated["Image size"] == "200 x 200 px"
    assert stated["Interpolation"] == "B-spline of degree 3"
    assert stated["Regularisation length"] == "cut-off wavelength 40 px"
    assert stated["Status"] == "converged"
    assert stated["Grey levels, reference"].startswith("8 bit, ")
    summary = json.loads((folder / "result.json").read_text())
    assert stated["Displacement noise floor"].startswith(f"{summary['noise_floor_px']:.3g} px = ")
    # Noise of 2 grey levels and rounding in both images; interpolation averages some of it out.
    assert 1.7 < float(stated["Image noise"].split()[0]) < 2.2
    for name in ("Displacement spatial resolution", "Strain noise floor", "Strain spatial resolution "
                 "(virtual strain gauge)", "Element size (subset size and step)", "Feature size of the pattern"):
        assert not stated[name].startswith(NOT_RECORDED), name


def change(folder: Path, target: Path, *, summary: dict[str, Any] | None = None,
           images: dict[str, Any] | None = None, regularization: dict[str, Any] | None = None,
           uncertainty: dict[str, Any] | None = None) -> dict[str, str]:
    """What is stated where the summary, two sections of the case or the uncertainty say something else."""
    result = read_result(folder / "result.vtkhdf")
    case = json.loads(str(result.attributes["case"]["json"]))
    case["images"] |= images or {}
    case["regularization"] |= regularization or {}
    attributes = {**result.attributes, "case": {**result.attributes["case"], "json": json.dumps(case)}}
    if uncertainty:
        attributes["uncertainty"] = uncertainty
    (target / "result.json").write_text(json.dumps(json.loads((folder / "result.json").read_text()) | (summary or {})))
    changed = replace(result, path=target / "result.vtkhdf", attributes=attributes)
    return {name: value for items in list_statements(gather_all(changed)).values() for name, value in items}


def test_noise_is_that_which_was_measured(folder: Path, tmp_path: Path) -> None:
    stated = change(folder, tmp_path, images={"at_rest": "rest.tif"},
                    uncertainty={"noise_grey": 2.0625, "noise_origin": "of the images at rest"})
    assert stated["Image noise"] == "2.06 grey levels (of the images at rest)"
    asked = change(folder, tmp_path, images={"at_rest": "rest.tif"})["Image noise"]
    assert asked.endswith("all noise; images.at_rest is measured with output.uncertainty = true alone")


@pytest.mark.parametrize("size", ["a b", "nan", "200xx200", "-200x200", "2e2x2e2"])
def test_a_size_that_is_damaged_is_not_recorded(folder: Path, tmp_path: Path, size: str) -> None:
    result = read_result(folder / "result.vtkhdf")
    provenance = {**result.attributes["provenance"], "reference_size": size}
    damaged = replace(result, path=tmp_path / "result.vtkhdf",
                      attributes={**result.attributes, "provenance": provenance})
    stated = {name: value for items in list_statements(gather_all(damaged)).values() for name, value in items}
    assert stated["Field of view"] == NOT_RECORDED


def test_the_material_is_stated(folder: Path, tmp_path: Path) -> None:
    assert change(folder, tmp_path)["Material"] == "isotropic, Poisson's ratio 0.3, plane stress"
    of_composite = {"young_ratio": 15.0, "material_angle_degrees": 30.0}
    assert change(folder, tmp_path, regularization=of_composite)["Material"] == (
        "orthotropic, E1 / E2 = 15, G12 / E2 = 0.3846, nu12 = 0.3, axis 1 at 30 degrees from +x to +y, plane stress")


def test_a_blurred_reference_is_stated_as_a_filter(folder: Path, tmp_path: Path) -> None:
    note = f"{BLUR_NOTE}, which is blurred as much: standard deviation 1.2 px at 0 degrees, 0.3 px across"
    stated = change(folder, tmp_path, summary={"notes": ["something else", note]})
    assert stated["Image filtering by ddic"] == f"none but the interpolating spline; {note}"


def test_the_report_states_all_that_the_case_can_say_of_the_images() -> None:
    assert {key for _, key in OF_SETUP} | {"processing"} == set(AcquisitionSection.model_fields)


def test_the_guide_is_compared_with_what_is_stated(folder: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "report.md").read_text(encoding="utf-8")
    rows = [line.split("|") for line in text.partition("## Beside the guide")[2].splitlines() if line.startswith("| ")]
    named = [name for row in rows[1:] for name in re.findall(r"\*([^*]+)\*", row[2])]
    # Two tables: the guide's items of the set-up and of the analysis.
    assert len(rows) > 24
    assert set(named) - set(state(folder / "result.vtkhdf")) == set()


def test_page_holds_all_and_asks_for_nothing(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert unescape(CASE) in unescape(text)
    assert "<title>a &lt;strip&gt; &amp; its hole" in text
    assert text.count("<img ") == 11
    assert "<script" not in text
    targets = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert all(target.startswith("data:") for target in targets)
    assert "url(" not in text
    assert "@import" not in text


def test_missing_images_and_summary_are_said(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "result.vtkhdf").write_bytes((folder / "result.vtkhdf").read_bytes())
    (folder / "images").rename(folder / "gone")
    try:
        page = write(tmp_path)
        stated = state(tmp_path / "result.vtkhdf")
        with_image = write(tmp_path, "--image", str(folder / "gone" / "reference.tif"))
    finally:
        (folder / "gone").rename(folder / "images")
    for name in ("reference", "deformed"):
        assert f"The {name} image is no longer at " in page
        assert stated[f"Grey levels, {name}"] == f"{NOT_RECORDED}: the image is not there"
    assert "The summary result.json is not beside the result" in page
    assert "on the mesh; the reference image is not there" in page
    # All but the histogram of the images.
    assert page.count("<img ") == 10
    assert "The reference image" not in with_image
    ran = CliRunner().invoke(report, [str(folder / "result.vtkhdf"), "--image", str(tmp_path / "no.tif")])
    assert ran.exit_code == 2
    assert "no.tif: no such image; check --image" in ran.output


def test_a_frame_of_a_series_is_shown_with_the_curves_of_all(tmp_path: Path, folder: Path) -> None:
    path = write_series_file(tmp_path / "s.vtkhdf", [FrameFile(1.0), FrameFile(2.0)])
    ((name, _, figure),) = draw_report_figures(gather_all(read_series(path)[1]), [])["series"]
    assert (name, len(figure.axes)) == ("curves", 5)
    write_report(read_series(path)[1], tmp_path / "s.html")
    page = (tmp_path / "s.html").read_text()
    assert "All frames of the series" in page
    # What the frame's verdict says stands above all.
    assert "Look before you trust this field: a place of frame 2" in page
    assert state(folder / "result.vtkhdf")["Verdict"] == "trust this field"
    assert draw_report_figures(gather_all(read_result(folder / "result.vtkhdf")), [])["series"] == []


def test_a_measurement_from_memory_has_a_report(tmp_path: Path) -> None:
    pair = ddic.make_synthetic_pair(lambda points: np.full_like(points, 0.3), (120, 120), seed=1)
    result = ddic.measure(pair, ddic.structured_mesh((10, 10, 110, 110), 20))
    ddic.write_report(result, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "The reference image was in memory" in page
    assert "a measurement from Python has none" in page


def test_a_field_that_did_not_converge_is_no_result(tmp_path: Path) -> None:
    pair = ddic.make_synthetic_pair(lambda points: np.full_like(points, 0.3), (120, 120), seed=1)
    options = {"gauss_newton": {"max_iterations": 1, "rms_tolerance": 1e-12, "tolerance": 1e-12}}
    with pytest.raises(ConvergenceError) as raised:
        ddic.measure(pair, ddic.structured_mesh((10, 10, 110, 110), 20), **options)
    ddic.write_report(raised.value.result, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "This field did not converge: " in page
    assert "NOT CONVERGED" in page


def test_worst_places_are_the_worst_and_lie_apart(folder: Path) -> None:
    result = read_result(folder / "result.vtkhdf")
    rms = result.cell_data["residual_rms"]
    rms[[40, 41, 150]] = [50.0, 49.0, 45.0]
    result.cell_data["doubtful"][150] = 1
    result.cell_data["excluded"][40] = 2
    places = find_worst_places(result)
    assert [place.residual_rms for place in places[:2]] == [50.0, 45.0]
    assert places[0].verdict == "excluded: it shows something else than the reference"
    assert places[1].verdict.startswith("doubtful")
    centres = np.array([place.position for place in places])
    apart = np.linalg.norm(centres[:, None] - centres, axis=2)[np.triu_indices(len(centres), 1)]
    assert apart.min() >= 0.08 * np.hypot(176.0, 176.0)


def test_feature_size_is_that_of_the_pattern(tmp_path: Path) -> None:
    """White noise blurred by a Gaussian of standard deviation s has a correlation exp(-d^2 / 4 s^2): 4 sqrt(ln 2) s."""
    import cv2
    import tifffile

    white = np.random.default_rng(0).normal(size=(400, 400))
    for s in (1.5, 4.0):
        blurred = cv2.GaussianBlur(white, (0, 0), s)
        path = tmp_path / f"{s}.tif"
        tifffile.imwrite(path, np.round(127 + 40 * blurred / blurred.std()).clip(0, 255).astype(np.uint8))
        places = np.array([[x, y] for x in (80, 200, 320) for y in (80, 200, 320)], float)
        # Nine windows hold some thousand features of the smaller size, some hundred of the larger one.
        found = measure_feature_size(open_image(path), places)
        assert found == pytest.approx(4 * np.sqrt(np.log(2.0)) * s, rel=0.1)


def test_no_text_on_a_picture_is_cut_or_too_small(folder: Path) -> None:
    result = read_result(folder / "result.vtkhdf")
    drawn = draw_report_figures(gather_all(result), find_worst_places(result))
    for of_section in drawn.values():
        for name, _, figure in of_section:
            assert find_clipped_texts(figure) == [], name
            assert find_smallest_type(figure) >= 6.0, name  # points: 7 px on a screen where a picture is made smaller


@pytest.mark.skipif(find_browser() is None, reason="no Chromium is installed")
def test_a_browser_shows_every_picture_and_asks_for_nothing(page: Path, tmp_path: Path) -> None:
    browser = find_browser()
    assert browser is not None
    shown = show_page(browser, page, tmp_path / "page.png")
    assert len(shown.pictures) == 11
    for picture in shown.pictures:
        # Made smaller by a browser or by Lanczos: alike to some per cent.
        assert picture.likeness >= LEAST_LIKENESS, picture
        assert picture.scale > 0.6, picture
    assert shown.overflowing == []
    assert shown.requests == []


@pytest.mark.skipif(find_browser() is None, reason="no Chromium is installed")
def test_a_request_would_be_seen(tmp_path: Path) -> None:
    """That none is seen says something only if one would be."""
    page = tmp_path / "asking.html"
    page.write_text('<html><body><main><img alt="" src="http://images.example/a.png"></main></body></html>')
    browser = find_browser()
    assert browser is not None
    assert probe_page(browser, page, tmp_path)[1] == ["http://images.example/a.png"]

"""Element sizes and wavelengths about those of a case."""

from __future__ import annotations

from pathlib import Path

import pytest

from ddic.case.loader import parse_case_text
from ddic.case.schema import Case
from ddic.methods.sweep import list_element_sizes, list_wavelengths, set_resolution


def make_case(mesh: str = 'structured = { region = [0, 0, 90, 200], element_size = 64 }', more: str = "") -> Case:
    text = f'[images]\nreference = "f.tif"\ndeformed = "g.tif"\n[mesh]\n{mesh}\n{more}'
    return parse_case_text(text, Path("case.toml"))


def test_sizes_and_wavelengths_lie_about_the_own_ones() -> None:
    case = make_case(more="[regularization]\ncut_off_wavelength = 100")
    # Two sizes more would be wider than the region.
    assert list_element_sizes(case) == [64.0, 32.0, 45.3]
    lengths = list_wavelengths(case, 64.0)
    assert lengths[:2] == [100.0, 0.0]
    assert sorted(lengths) == [0.0, 25.0, 35.4, 50.0, 70.7, 100.0, 141.0, 200.0, 283.0, 400.0]


@pytest.mark.parametrize("more", ["", "[regularization]\neta = 3.0"])
def test_without_a_wavelength_five_elements_are_the_middle(more: str) -> None:
    lengths = list_wavelengths(make_case(more=more), 10.0)
    assert lengths[0] == 0.0
    assert sorted(lengths)[5] == 50.0


def test_a_mesh_file_keeps_its_elements() -> None:
    case = make_case('file = "mesh.msh"')
    assert list_element_sizes(case) == [None]
    assert set_resolution(case, None, 30.0).mesh == case.mesh


def test_all_else_of_the_case_stays() -> None:
    case = make_case(more="[regularization]\neta = 3.0\npoisson_ratio = 0.2")
    other = set_resolution(case, 20.0, 90.0)
    assert other.mesh.structured is not None
    assert other.mesh.structured.element_size == 20.0
    assert other.regularization is not None
    assert (other.regularization.cut_off_wavelength, other.regularization.eta) == (90.0, None)
    assert other.regularization.poisson_ratio == 0.2
    assert not other.output.residual_image
    assert set_resolution(case, 20.0, 0.0).regularization is None
    plain = set_resolution(make_case(), None, 40.0).regularization
    assert plain is not None
    assert plain.cut_off_wavelength == 40.0

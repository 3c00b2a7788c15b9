"""Case files: values, paths, and messages for everything that can be wrong."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from ddic.case.loader import load_case, load_case_leniently
from ddic.case.schema import Case
from ddic.errors import InputError

NEAR = '[[near]]\nreference = "n.tif"\ndeformed = "m.tif"\nratio = 2\noffset = [0, 0]\n'

SMALLEST = """
[images]
reference = "f.tif"
deformed = "pairs/g.tif"
[mesh.structured]
region = [0, 0, 64, 48.5]
element_size = 16
"""
DOCUMENT = Path(__file__).parents[2] / "docs" / "case-file.md"


def _problems(tmp_path: Path, text: str) -> tuple[str, ...]:
    path = tmp_path / "case.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_case(path)
    assert all(line.startswith(f"{path}: ") and "\n" not in line for line in caught.value.problems)
    return tuple(line.removeprefix(f"{path}: ") for line in caught.value.problems)


def test_values_and_absolute_paths(tmp_path: Path) -> None:
    path = tmp_path / "case.toml"
    path.write_text(SMALLEST + '[mesh]\n[start]\nfrom_result = "/data/old.vtkhdf"\n[solver]\nblocks = [2, 3]\n'
                               'partition = "blocks"\n')
    loaded = load_case(path)
    assert loaded.text == path.read_text()
    assert loaded.path == path
    case = loaded.case
    assert case.images.deformed == tmp_path / "pairs" / "g.tif"
    assert case.output.file == tmp_path / "result.vtkhdf"
    assert case.start.from_result == Path("/data/old.vtkhdf")
    assert case.images.reference_mask is None
    assert case.mesh.structured is not None
    assert case.mesh.structured.region == (0.0, 0.0, 64.0, 48.5)
    assert case.solver.blocks == (2, 3)


def test_relative_case_file_gives_absolute_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "case.toml").write_text(SMALLEST + 'mask = "m.png"\n')
    monkeypatch.chdir(tmp_path)
    case = load_case(Path("case.toml")).case
    assert case.images.reference == tmp_path / "f.tif"
    assert case.mesh.structured is not None
    assert case.mesh.structured.mask == tmp_path / "m.png"


@pytest.mark.parametrize(("addition", "line"), [
    ("[solver]\nsubdomain = 4", 'solver.subdomain: unknown key; did you mean "subdomains"?'),
    ("[solver]\nspline_degree = 5", "solver.spline_degree: unknown key; it belongs to [correlation]"),
    ("[start]\nqqq = 5",
     "start.qqq: unknown key; valid here: rigid, features, pyramid, independent, largest_enriched_block, from_result, "
     "frame, from_points, points"),
    ("[solvers]\n", 'solvers: unknown key; did you mean "solver"?'),
    ('[solver]\nsubdomains = "4"', 'solver.subdomains = "4": expected a whole number'),
    ("[solver]\nsubdomains = 4.5", "solver.subdomains = 4.5: expected a whole number"),
    ("[solver]\nsubdomains = true", "solver.subdomains = true: expected a whole number"),
    ("[solver]\nsubdomains = 0", "solver.subdomains = 0: expected at least 1"),
    ("[solver]\ntolerance = 1.0", "solver.tolerance = 1.0: expected less than 1"),
    ('[solver]\nmethod = "Dual"',
     'solver.method = "Dual": expected "auto", "dual", "assembled", "conjugate_gradient", "matching" or "monolithic"'),
    ("[correlation]\nspline_degree = 4", "correlation.spline_degree = 4: expected 3 or 5"),
    ('[gauss_newton]\ntolerance = "a"', 'gauss_newton.tolerance = "a": expected a number'),
    ("[gauss_newton]\nrms_tolerance = nan", "gauss_newton.rms_tolerance = nan: expected a finite number"),
    ("[gauss_newton]\ntolerance = 2024-01-01", "gauss_newton.tolerance = 2024-01-01: expected a number"),
    ("[output]\nfile = 3", "output.file = 3: expected a text in quotes"),
    ("[output]\nflip_y = 1", "output.flip_y = 1: expected true or false"),
    ("[regularization]\nboxes = [[1, 2, 3]]\neta = 1",
     "regularization.boxes[0] = [1, 2, 3]: expected at least 4 items"),
    ("[regularization]\nboxes = [[1, 2, 3, inf]]\neta = 1",
     "regularization.boxes[0][3] = inf: expected a finite number"),
    ("[regularization]\nnot_controlled = [[]]\neta = 1",
     "regularization.not_controlled[0] = []: expected a text in quotes"),
    ("[solver]\nblocks = [1, 2, 3]\npartition = 'blocks'",
     "solver.blocks: 3 numbers, 2 expected beside [images]"),
    (f"{NEAR}masked = [[1, 2, 3, 4, 5, 6]]", "near[0].masked: 6 numbers, 4 expected beside [images]"),
    (f"{NEAR}mesh.structured = {{region = [0, 0, 0, 9, 9, 9], element_size = 3}}",
     "near[0].mesh.structured.region: 6 numbers, 4 expected beside [images]"),
    ("[discontinuity]\nvertices = [[0, 0], [9, 9]]",
     "discontinuity: one section is given, a list of them expected: [[discontinuity]], or [{...}] in Python"),
    ("[regularization]\nplane = 'stress'",
     "regularization: give either regularization.cut_off_wavelength or regularization.eta"),
    ("[regularization]\neta = 1\npoisson_ratio = 0.5",
     "regularization: regularization.poisson_ratio = 0.5: an isotropic material has less than 0.5; of a composite give "
     "young_ratio or shear_ratio, too"),
    ("[regularization]\neta = 1\nmaterial_angle_degrees = 45",
     "regularization: regularization.material_angle_degrees goes with young_ratio or shear_ratio: an isotropic "
     "material has no axes"),
    ("[regularization]\neta = 1\nyoung_ratio = 0.06",
     "regularization: regularization.poisson_ratio = 0.3 with young_ratio = 0.06: no material has nu12 squared as "
     "large as E1 / E2; give less than 0.245, or call the stiffer axis 1"),
    ("[regularization]\neta = 1\nyoung_ratio = 140000\nshear_ratio = 5000",
     "regularization: regularization.young_ratio = 140000, shear_ratio = 5000 with poisson_ratio = 0.3: one modulus is "
     "140000 times another, more than 5000: rounding would hide the images; give E1 / E2 and G12 / E2, not moduli"),
    ("[regularization]\neta = 1\nshear_ratio = 0.2\nplane = 'strain'",
     'regularization: regularization.plane = "strain" goes with an isotropic material, for it asks for moduli across '
     "the plane; leave it out, or young_ratio and shear_ratio"),
    ("[regularization]\neta = 1\nyoung_ratio = 0", "regularization.young_ratio = 0: expected more than 0"),
    ('[solver]\npartition = "blocks"',
     'solver: solver.blocks = [columns, rows] goes with solver.partition = "blocks"'),
])
def test_one_clear_line(tmp_path: Path, addition: str, line: str) -> None:
    assert _problems(tmp_path, SMALLEST + addition) == (line,)


COMPOSITE = "[regularization]\ncut_off_wavelength = 64\nyoung_ratio = 15\nmaterial_angle_degrees = 30\n"


@pytest.mark.parametrize(("addition", "start"), [
    ("[[discontinuity]]\nvertices = [[0, 0], [9, 9]]\ntip_functions = true",
     "discontinuity.tip_functions are those of an isotropic material"),
    ("[pgd]", "regularization.material_angle_degrees = 30: products of functions of x and of y"),
])
def test_what_knows_isotropic_matter_only_is_refused(tmp_path: Path, addition: str, start: str) -> None:
    (line,) = _problems(tmp_path, f"{SMALLEST}{COMPOSITE}{addition}")
    assert line.startswith(start)
    _load(tmp_path, f"{SMALLEST}[regularization]\ncut_off_wavelength = 64\n{addition}")


def _load(tmp_path: Path, text: str) -> None:
    path = tmp_path / "case.toml"
    path.write_text(text)
    load_case(path)


@pytest.mark.parametrize("keys", ["young_ratio = 0.2", "young_ratio = 1.0\nmaterial_angle_degrees = 30",
                                  "young_ratio = 1.5\npoisson_ratio = 1.2\nshear_ratio = 2"])
def test_composites_that_exist_are_taken(tmp_path: Path, keys: str) -> None:
    _load(tmp_path, f"{SMALLEST}[regularization]\ncut_off_wavelength = 64\n{keys}\n")


def test_all_problems_at_once(tmp_path: Path) -> None:
    text = '[images]\nreference = 1\n[solver]\ntolerance = 3\n[mesh.structured]\nregion = 4\nelement_size = 2\n'
    assert _problems(tmp_path, text) == (
        "images.reference = 1: expected a text in quotes",
        "images.deformed: this key is missing; it has no default",
        "mesh.structured.region = 4: expected a list in square brackets",
        "solver.tolerance = 3: expected less than 1",
    )


@pytest.mark.parametrize(("value", "lines"), [
    ("3", ["3: expected a text in quotes"]),
    ("[]", ["[]: expected at least 1 items"]),
    ("1979-05-27", ["1979-05-27: expected a text in quotes"]),
    ('["a.tif", 3]', None),
])
def test_a_value_of_one_kind_or_several_is_told_once(tmp_path: Path, value: str, lines: list[str] | None) -> None:
    path = tmp_path / "case.toml"
    path.write_text(f'[images]\nreference = "f.tif"\ndeformed = {value}\n[mesh.structured]\n'
                    "region = [0, 0, 9, 9]\nelement_size = 3\n")
    with pytest.raises(InputError) as caught:
        load_case(path)
    told = [line.removeprefix(f"{path}: images.deformed") for line in caught.value.problems]
    assert told == (["[1] = 3: expected a text in quotes"] if lines is None else [f" = {line}" for line in lines])
    # What is left of the case is checked all the same.
    case, problems = load_case_leniently(path)
    assert case is None
    assert list(caught.value.problems) == problems[:len(told)]


def test_missing_sections(tmp_path: Path) -> None:
    assert _problems(tmp_path, "") == ("images: this section is missing; it has no default",
                                       "mesh: this section is missing; it has no default")


def test_section_that_is_a_value(tmp_path: Path) -> None:
    assert _problems(tmp_path, "solver = 3\n" + SMALLEST) == (
        "solver = 3: expected a section, [name] with keys below it",)


def test_syntax_error_names_the_line(tmp_path: Path) -> None:
    (line,) = _problems(tmp_path, SMALLEST + "a = = 2\n")
    assert line.startswith("not valid TOML: ")
    assert "line 8" in line


def test_long_values_are_shortened(tmp_path: Path) -> None:
    (line,) = _problems(tmp_path, SMALLEST + "[output]\nflip_y = '" + 500 * "x" + "'\n")
    assert len(line) < 120


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read this case file \\(No such file"):
        load_case(tmp_path / "none.toml")
    (tmp_path / "latin.toml").write_bytes(b'title = "\xe9"')
    with pytest.raises(InputError, match="is not UTF-8 text"):
        load_case(tmp_path / "latin.toml")


JUNK = st.one_of(st.booleans(), st.integers(-5, 5), st.floats(-2, 2), st.text("abc", max_size=3),
                 st.lists(st.integers(0, 3), max_size=4), st.just({"a": 1}))


def _keys(section: type[BaseModel], prefix: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    found = []
    for name, field in section.model_fields.items():
        found.append((*prefix, name))
        for inner in _sections_in(field.annotation):
            found += _keys(inner, (*prefix, name))
    return found


def _sections_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for part in get_args(annotation) for found in _sections_in(part)]


ALL_KEYS = _keys(Case)


@given(key=st.sampled_from([k for k in ALL_KEYS if "circles" not in k and "polygons" not in k]), value=JUNK)
def test_any_value_at_any_key_loads_or_is_explained(tmp_path_factory: pytest.TempPathFactory,
                                                    key: tuple[str, ...], value: Any) -> None:
    shown = {bool: lambda v: str(v).lower(), str: lambda v: f'"{v}"', dict: lambda _: "{a = 1}"}
    path = tmp_path_factory.getbasetemp() / "any.toml"
    given_keys = f"{'.'.join(key)} = {shown.get(type(value), repr)(value)}\n"
    path.write_text(given_keys)
    # Images or mesh are always missing; what is asserted is that nothing but InputError comes out.
    with pytest.raises(InputError) as caught:
        load_case(path)
    assert all(line.startswith(f"{path}: ") for line in caught.value.problems)
    assert not any("pydantic" in line or "Input should" in line for line in caught.value.problems)


def _described_as(section: tuple[str, ...]) -> tuple[str, ...]:
    """A near field's own mesh is described as the mesh is, what is in a region as in the structured one."""
    if section[:2] == ("near", "mesh"):
        section = section[1:]
    if section[:2] == ("region", "shape"):
        return ("mesh", "structured", "region")
    is_in_region = section[:2] == ("mesh", "unstructured") and len(section) > 2
    return ("mesh", "structured", *section[2:]) if is_in_region else section


def _documented_keys(section: tuple[str, ...]) -> str:
    """The part of the document that describes a section: from its heading to the next."""
    section = _described_as(section)
    name = ".".join(section)
    lists = dict.fromkeys(("circles", "polygons", "masked"), f"`[[{name}]]`")
    starts = lists if len(section) == 1 else {**lists, "region": f"a section `[{name}]`"}
    ends = {"circles": "\nA polygonal hole", "polygons": "\nA region that"}
    after = DOCUMENT.read_text(encoding="utf-8").partition(starts.get(section[-1], f"\n## [{name}]\n"))[2]
    return after.partition(ends.get(section[-1], "\n## "))[0]


@pytest.mark.parametrize("key", [key for key in ALL_KEYS if len(key) > 1], ids=".".join)
def test_every_key_is_documented_in_its_section(key: tuple[str, ...]) -> None:
    assert f"| `{key[-1]}` |" in _documented_keys(key[:-1])


def test_sections_are_documented() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    sections = {_described_as(key[:-1]) for key in ALL_KEYS if len(key) > 1}
    assert all(f"[{'.'.join(section)}]" in text for section in sections)
    assert "| `title` |" in text


def test_examples_of_the_document_are_valid(tmp_path: Path) -> None:
    blocks = re.findall(r"```toml\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(blocks) == 5
    for block in blocks:
        (tmp_path / "case.toml").write_text(block if "[images]" in block else SMALLEST.partition("[mesh")[0] + block)
        load_case(tmp_path / "case.toml")


@pytest.mark.parametrize("threads", ["1e23", "1025", "100000000000000000000000"])
def test_threads_without_end_are_refused(tmp_path: Path, threads: str) -> None:
    problems = _problems(tmp_path, SMALLEST + f"[solver]\nthreads = {threads}\n")
    assert len(problems) == 1
    assert problems[0].startswith("solver.threads = ")


@pytest.mark.parametrize(("line", "hint"), [
    (r'reference = "C:\users\me\f.tif"', "write the path in '...', or with /"),
    ("pixel_size = 0,0125", "numbers have a decimal point, no comma"),
    ("pixel_size = -3,5 # mm", "numbers have a decimal point, no comma"),
    ("pixel_size = 0.0125 0.1", ""),
])
def test_mistakes_that_everybody_makes_are_told_with_their_remedy(tmp_path: Path, line: str, hint: str) -> None:
    path = tmp_path / "case.toml"
    path.write_text(f"[images]\n{line}\n")
    with pytest.raises(InputError) as caught:
        load_case(path)
    said = str(caught.value)
    assert said.endswith(hint or "(at line 2, column 21)")
    assert "at line 2" in said

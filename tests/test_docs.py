"""The documents speak of what exists."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel

from accept.support.unrun_blocks import CHECKS, find_faults, find_spoken_faults
from bench.papers.__main__ import CHAPTERS
from ddic.case import schema
from ddic.case.schema import find_section

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "scripts"))
write_tables = importlib.import_module("write_case_reference").write_tables
SOURCE = ROOT / "src" / "ddic"
DOCUMENTS = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md")),
             *sorted((ROOT / "examples").glob("*/README.md"))]
MODULE_FOLDERS = [ROOT / name for name in ("src", "scripts", "bench", "accept", "examples", "tests")]
SECTIONS: dict[str, type[BaseModel]] = {
    "Top level": schema.Case,
    "[images]": schema.ImagesSection,
    "[volumes]": schema.VolumesSection,
    "[near]": schema.NearSection,
    "[mesh]": schema.MeshSection,
    "[mesh.structured]": schema.StructuredSection,
    "[mesh.unstructured]": schema.UnstructuredSection,
    "[mesh.mapping]": schema.MappingSection,
    "[discontinuity]": schema.DiscontinuitySection,
    "[correlation]": schema.CorrelationSection,
    "[regularization]": schema.RegularizationSection,
    "[regularization.stiffness]": schema.StiffnessSection,
    "[solver]": schema.SolverSection,
    "[gauss_newton]": schema.GaussNewtonSection,
    "[start]": schema.StartSection,
    "[pgd]": schema.PgdSection,
    "[series]": schema.SeriesSection,
    "[region]": schema.RegionSection,
    "[simulation]": schema.SimulationSection,
    "[simulation.mapping]": schema.MappingSection,
    "[identification]": schema.IdentificationSection,
    "[identification.material]": schema.MaterialSection,
    "[identification.force]": schema.ForceSection,
    "[output]": schema.OutputSection,
    "[acquisition]": schema.AcquisitionSection,
}
SHAPES = {schema.CircleSection, schema.PolygonSection, schema.ShapeSection}

named = pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))


def code_blocks(document: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", document.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def table_rows(text: str) -> Iterator[list[str]]:
    """Cells of the rows of all tables, without their headings and rules."""
    for line in text.splitlines():
        if line.startswith("|") and not re.fullmatch(r"[|\- ]+", line):
            yield [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def quoted(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def symbol_rows() -> list[list[str]]:
    # The table of equations has a test of its own, test_equations.py.
    text = (ROOT / "docs" / "symbols.md").read_text(encoding="utf-8").split("## Equations of")[0]
    rows = list(table_rows(text))
    return [row for row in rows if row[0] != "symbol"]


def has_name(files: list[str], name: str) -> bool:
    return any(re.search(rf"\b{re.escape(name)}\b", (ROOT / file).read_text(encoding="utf-8")) for file in files)


def test_table_of_symbols_is_read() -> None:
    assert len(symbol_rows()) > 40
    assert not has_name(["src/ddic/errors.py"], "no_such_name")


@pytest.mark.parametrize("row", symbol_rows(), ids=lambda row: row[0])
def test_names_and_files_of_a_symbol_exist(row: list[str]) -> None:
    names, files = quoted(row[3]), quoted(row[4])
    assert names
    assert files
    assert [file for file in files if not (ROOT / file).is_file()] == []
    assert [name for name in names if not has_name(files, name)] == []
    # A file that holds none of the names does not belong in the row.
    assert [file for file in files if not any(has_name([file], name) for name in names)] == []


@pytest.mark.parametrize("symbol", [
    "f", "g", "u", "N", "q, q_s", "M, M_s", "b, b_s", "K", "P", "Kbar, Kbar_s", "eta", "l_c", "m", "w", "A_s", "C_s",
    "Cbar_s", "Lambda, LambdaBar", "c", "B_s", "T_s", "G_s", "D_s", "H_s", "S_tot", "S_s"])
def test_symbol_is_listed(symbol: str) -> None:
    assert symbol in [row[0] for row in symbol_rows()]


@named
def test_links_of_a_document_lead_somewhere(document: Path) -> None:
    links = re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]+))?\)", document.read_text(encoding="utf-8"))
    local = [(document.parent / path if path else document, anchor) for path, anchor in links if "://" not in path]
    assert [path for path, _ in local if not path.exists()] == []
    assert [(path, anchor) for path, anchor in local if anchor and anchor not in anchors_of(path)] == []


def anchors_of(document: Path) -> list[str]:
    """Anchors of the headings, as they are made where Markdown is shown; the site's are checked when it is built."""
    text = re.sub(r"^```.*?^```", "", document.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    headings = [re.sub(r"\[(.*?)\]\(.*?\)", r"\1", title) for title in re.findall(r"^#+ (.*)", text, re.MULTILINE)]
    return [re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in headings]


def is_python_file(mention: str) -> bool:
    """Whether a file NAME.py, or FOLDER/NAME.py with any leading folders left out, exists."""
    return any(path.as_posix().endswith("/" + mention) for folder in MODULE_FOLDERS for path in folder.rglob("*.py"))


def is_package_member(mention: str) -> bool:
    """Whether ddic.a.b is a module, or names something that the text of module ddic.a holds."""
    parts = mention.split(".")[1:]
    for n in range(len(parts), -1, -1):
        path = SOURCE.joinpath(*parts[:n])
        module = path.with_suffix(".py") if n and path.with_suffix(".py").is_file() else path / "__init__.py"
        if module.is_file():
            return all(re.search(rf"\b{name}\b", module.read_text(encoding="utf-8")) for name in parts[n:])
    return False


def test_check_of_modules_can_fail() -> None:
    assert is_python_file("solvers/gauss_newton.py")
    assert not is_python_file("mesh/gauss_newton.py")
    assert is_package_member("ddic.errors.InputError")
    assert is_package_member("ddic.solvers.dual")
    assert not is_package_member("ddic.errors.NoSuchError")


@named
def test_modules_that_a_document_mentions_exist(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    files = re.findall(r"(?<![\w./])((?:\w+/)*\w+\.py)\b", text)
    # ddic.log is the output of a job, not a module.
    modules = re.findall(r"(?<![\w/.-])(ddic(?!\.log\b)(?:\.[a-z]\w*)+(?:\.[A-Z]\w*)?)\b", text)
    assert [file for file in files if not is_python_file(file)] == []
    assert [module for module in modules if not is_package_member(module)] == []


def is_folder(mention: str) -> bool:
    """Whether a folder of the repository exists, or one of the package with any leading folders left out."""
    inside = (path.as_posix() for path in SOURCE.rglob("*") if path.is_dir())
    return (ROOT / mention).is_dir() or any(path.endswith("/" + mention) for path in inside)


@named
def test_folders_of_the_package_that_a_document_mentions_exist(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    trees = re.findall(r"^(?:    |```\w*\n)[ \n]*((?:\w+/)+)(?:\s|$)", text, re.MULTILINE)
    folders = [name.rstrip("/") for name in [*quoted(text), *trees] if re.fullmatch(r"(?:\w+/)+", name)]
    assert [name for name in folders if not is_folder(name)] == []


def sections_of_case_file() -> dict[str, str]:
    text = (ROOT / "docs" / "case-file.md").read_text(encoding="utf-8")
    parts = re.split(r"^## (.+)\n", text, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def test_every_section_is_documented() -> None:
    assert list(sections_of_case_file()) == list(SECTIONS)


def test_tables_of_the_case_file_are_those_of_the_schema() -> None:
    document = ROOT / "docs" / "case-file.md"
    text = document.read_text(encoding="utf-8")
    assert write_tables(text) == text, "run python scripts/write_case_reference.py"
    marked = re.findall(r"<!-- keys: ?([\w.]*) -->", text)
    assert {find_section(tuple(name.split(".")) if name else ()) for name in marked} == {*SECTIONS.values(), *SHAPES}


@named
def test_blocks_that_are_not_run_say_what_exists(document: Path) -> None:
    if document.name != "CHANGELOG.md":    # which tells of what was
        assert find_faults(document) == []


@pytest.mark.parametrize(("language", "text", "fault"), [
    ("toml", "[mesh.structured]\nregion = [0, 0, 9, 9]\nelement_side = 3", "element_side"),
    ("toml", "[regularisation]\ncut_off_wavelength = 60", "regularisation"),
    ("toml", "[gauge.a]\ncentre = [1, 2]\nsize = 3", "size"),
    ("csv", "x,y,u,v\n1,2,3", "column v is missing"),
    ("text", "no example prints this", "prints"),
    ("sh", "mpiexec -n 2 ddic run case.toml --ranks 2", "ddic run takes no --ranks"),
    ("sh", "cd tour && ddic synth kirsch --speed 2 | tail -1", "ddic synth takes no --speed"),
    ("sh", "ddic measure case.toml", "ddic knows no measure"),
    ("sh", "make everything", "make knows no everything"),
    ("sh", "for x in; ddic", "syntax error"),
    ("python", "import ddic\nddic.measure(pair, options=ddic.Options())", "there is no ddic.Options"),
    ("python", "import ddic\nddic.measure(pair, mesh, wavelength=3)", "ddic.measure takes no wavelength"),
])
def test_wrong_blocks_are_found(language: str, text: str, fault: str) -> None:
    assert fault in "; ".join(CHECKS[language](text))


@pytest.mark.parametrize(("code", "fault"), [
    ("ddic plot result.vtkhdf --colour red", "ddic plot takes no --colour"),
    ("make accept-pgd CHECK=noise", "make knows no noise"),
    ("ddic.measure(..., options=1)", "ddic.measure takes no options"),
    ("[mesh.grid]", "there is no section mesh.grid"),
    ("gauss_newton.iterations = 3", "there is no key gauss_newton.iterations"),
])
def test_wrong_code_in_sentences_is_found(code: str, fault: str) -> None:
    assert find_spoken_faults(code) == [fault]


def test_tour_is_the_demo() -> None:
    tour = (ROOT / "README.md").read_text(encoding="utf-8").split("## A five-minute tour")[1].split("\n## ")[0]
    demo = (ROOT / "examples" / "demo" / "run.sh").read_text(encoding="utf-8")
    demo = demo.replace('timeout 300 "${MPIEXEC:-mpirun}"', "mpirun")
    demo = re.sub(r'"\$out/([^"]*)"', r"tour/\1", demo)
    commands = re.findall(r"^.*\bddic (?:synth|run|plot) .*$", demo, re.MULTILINE)
    assert len(commands) == 3
    assert [command for command in commands if command not in tour] == []
    case = (ROOT / "examples" / "demo" / "case.toml").read_text(encoding="utf-8")
    assert case in code_blocks(ROOT / "README.md", "toml")


def test_every_picture_is_drawn_by_a_command_and_shown() -> None:
    tour = importlib.import_module("tour_pictures")
    drawn = [name for pictures in tour.DRAWN.values() for name in pictures.values()]
    kept = sorted(path.stem for path in (ROOT / "docs" / "pictures").iterdir())
    # make papers names each by the chapter that draws it.
    of_papers = [name for name in kept if name.startswith(CHAPTERS)]
    assert kept == sorted([*drawn, *tour.SCREEN, *tour.MEASURED, *of_papers])
    text = "".join(document.read_text(encoding="utf-8") for document in DOCUMENTS)
    shown = {Path(link).stem for link in re.findall(r"!\[[^\]]+\]\(([^)]+)\)", text)}
    assert shown == set(kept)
    for place, _ in tour.MEASURED.values():
        module, function = place.split(".")
        assert callable(getattr(importlib.import_module(f"accept.{module}"), function))


def test_pictures_are_small() -> None:
    pictures = sorted((ROOT / "docs" / "pictures").iterdir())
    assert pictures
    # They are part of every clone; half of them are the papers' figures.
    assert sum(path.stat().st_size for path in pictures) < 3_300_000

"""How the source is counted: its lines, its imports, and the ways from one module to another."""

from __future__ import annotations

from pathlib import Path

import pytest

from accept import source_rules
from accept.source_rules import Source, find_circles, find_way, read_source
from accept.table import Scale

FILES = {
    "__init__": '"""A package."""\n',
    "mesh/__init__": "",
    "mesh/mesh": '"""Meshes\n\nof cells."""\n\nSIDES = 4  # of a cell\n"""What SIDES are."""\n',
    "mesh/raster": '"""Rasters."""\n\nfrom ddic.mesh.mesh import (\n    SIDES,\n)\n\n\ndef draw():\n    return SIDES\n',
    "cli/run": "from ddic.mesh import raster\n\n\ndef draw():\n    from ddic.cli import app\n    return raster, app\n",
    "cli/app": "from ddic.cli.run import draw\n\n# Why.\n\n\ndef main():\n    draw()\n",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        path = tmp_path / f"{name}.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path


@pytest.fixture
def source(folder: Path) -> Source:
    return read_source(folder)


def test_lines_are_code_or_docstrings_or_neither(source: Source) -> None:
    counted = {name: (len(module.code), len(module.documented)) for name, module in source.files.items()}
    assert counted == {"__init__": (0, 1), "mesh/__init__": (0, 0), "mesh/mesh": (1, 4), "mesh/raster": (5, 1),
                       "cli/run": (4, 0), "cli/app": (3, 0)}
    # A statement, its target and its value.
    assert source.files["mesh/mesh"].density == 3


def test_imports_at_the_top_and_anywhere(source: Source) -> None:
    assert source.imported == {"mesh/mesh": set(), "mesh/raster": {"mesh/mesh"}, "cli/run": {"mesh/raster"},
                               "cli/app": {"cli/run"}}
    assert source.reached["cli/run"] == {"mesh/raster", "cli/app"}
    assert find_circles(source.imported) == []
    assert find_circles(source.reached) == [["cli/app", "cli/run"]]


def test_the_shortest_way_of_imports(source: Source) -> None:
    assert find_way(source.imported, "cli/app", "mesh/mesh") == ["cli/app", "cli/run", "mesh/raster", "mesh/mesh"]
    assert find_way(source.imported, "mesh/mesh", "cli/app") == []


def test_rows_say_what_breaks_them(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "mesh" / "mesh.py").write_text("from ddic.cli import app\n\nSIDES = app\n", encoding="utf-8")
    (folder / "cli" / "app.py").write_text("def main(comm):\n    comm.barrier()\n\n\ndef draw():\n    main(0)\n",
                                           encoding="utf-8")
    monkeypatch.setattr(source_rules, "SOURCE", folder)
    monkeypatch.setattr(source_rules, "FEWEST_LINES", 1)
    rows = {row.check: row for row in source_rules.measure_source(Scale(smoke=True))}
    measured = {check: row.measured for check, row in rows.items()}
    assert measured["files of src/"] == "6"
    assert measured["modules in one package"] == "cli: 2"
    assert measured["imports upwards through the layers"] == "mesh/mesh imports cli/app"
    assert measured["public names that src/ defines twice"] == "1: draw"
    assert measured["calls of a communicator outside parallel/"] == "cli/app.py:2"
    broken = {check for check, row in rows.items() if not row.holds}
    assert broken == {
        "lines of code of the middle module of src/",
        "modules of src/ below 40 lines of code",
        "import statements of src/, lines of all code",
        "imports upwards through the layers",
        "modules that are read from solve_frame to a linear step",
        "modules that are read from main to the pixel kernels",
        "calls of a communicator outside parallel/",
    }

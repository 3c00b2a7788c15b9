"""ddic draw and ddic view as commands and from Python: what they ask for, what they print, what they need."""

from __future__ import annotations

import re
import signal
import sys
import urllib.request
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from click.testing import CliRunner
from tornado.ioloop import IOLoop

import ddic
from ddic.cli.app import command_line
from ddic.errors import InputError
from ddic.page import HEIGHT, NotebookPage
from ddic.page.drawn_case import CaseFile, DrawnCase, check_text
from support.cases import case_text
from support.commands import DDIC, LIMIT, finished, started
from support.page_results import Motion, write_known


def say_missing(named: str) -> str:
    return (f"pages in the browser need {named}: {sys.executable} -m pip install {named.replace(' and ', ' ')}, "
            "or make page where ddic was set up by make")


@pytest.mark.parametrize(("missing", "named"), [
    (("bokeh", "tomlkit"), "bokeh and tomlkit"), (("bokeh",), "bokeh"), (("tomlkit",), "tomlkit")])
def test_an_installation_without_pages_says_so_in_a_line(
        folder: Path, monkeypatch: pytest.MonkeyPatch, missing: tuple[str, ...], named: str) -> None:
    """Commands end with code 2, before anything is read; functions raise the same."""
    for name in missing:
        monkeypatch.setitem(sys.modules, name, None)
    for arguments in (["draw", str(folder / "f.tif"), str(folder / "case.toml")], ["view", str(folder / "r.vtkhdf")],
                      ["draw", "absent.tif"]):
        ran = CliRunner().invoke(command_line, arguments)
        assert ran.exit_code == 2
        assert ran.output == say_missing(named) + "\n"
    result = ddic.open(write_known(folder / "r.vtkhdf", Motion()))
    for look in (lambda: ddic.draw(folder / "f.tif", folder / "case.toml"), lambda: ddic.view_results("r.vtkhdf"),
                 result.view):
        with pytest.raises(InputError) as raised:
            look()
        assert str(raised.value) == say_missing(named)
    assert not (folder / "case.toml").exists()


@pytest.mark.program
def test_it_does_so_where_bokeh_is_really_not_there(folder: Path) -> None:
    """And everything else of ddic is there."""
    code = ("import sys\nfrom importlib.abc import MetaPathFinder\n"
            "class Without(MetaPathFinder):\n"
            "    def find_spec(self, name, path=None, target=None):\n"
            "        if name.partition('.')[0] in ('bokeh', 'tomlkit', 'tornado'):\n"
            "            raise ModuleNotFoundError(name)\n"
            "sys.modules.update(bokeh=None, tomlkit=None, tornado=None)\nsys.meta_path.insert(0, Without())\n"
            "import ddic\nfrom ddic.cli.app import command_line\n"
            f"sys.argv = ['ddic', 'draw', {str(folder / 'f.tif')!r}]\ncommand_line()\n")
    job = finished([sys.executable, "-c", code])
    assert job.code == 2
    assert job.err == say_missing("bokeh and tomlkit") + "\n"


def test_help_does_not_bring_the_server() -> None:
    code = ("import sys\nfrom click.testing import CliRunner\nfrom ddic.cli.app import command_line\n"
            "for name in ('draw', 'view'):\n"
            "    result = CliRunner().invoke(command_line, [name, '--help'])\n"
            "    assert result.exit_code == 0 and 'Usage:' in result.output\n"
            "print([name for name in ('bokeh', 'tornado', 'tomlkit', 'numpy', 'matplotlib') if name in sys.modules])\n")
    job = finished([sys.executable, "-c", code])
    assert (job.code, job.out) == (0, "[]\n"), job.err


@pytest.mark.parametrize(("arguments", "line"), [
    (["draw", "absent.tif"], "absent.tif: no such image file; check the path"),
    (["draw", "f.tif", "case.txt"], "case.txt: the name of a case file ends in .toml"),
    (["draw", "g.tif", "case.toml"], "g.tif: case.toml has another reference image"),
    (["draw", "f.tif", "case.toml", "--deformed", "g.tif"], "--deformed: case.toml is there already"),
    (["view", "absent.vtkhdf"], "absent.vtkhdf: no such result file; check the path"),
    (["view", "f.tif"], "f.tif: "),
    (["view", "r.vtkhdf", "--probes", "absent.toml"], "absent.toml: cannot read this file of probes"),
    (["view", "r.vtkhdf", "--probes", "case.toml"], "case.toml: images: unknown kind of probe"),
    (["draw", "f.tif", "--port", "70000"], "70000 is not in the range"),
])
def test_bad_input_is_one_line(
        folder: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], line: str) -> None:
    monkeypatch.chdir(folder)
    (folder / "case.toml").write_text(case_text(), encoding="utf-8")
    write_known(folder / "r.vtkhdf", Motion())
    ran = CliRunner().invoke(command_line, arguments)
    assert ran.exit_code == 2
    assert line in ran.output
    assert ran.output.count("\n") == 1


@pytest.mark.parametrize("command", ["draw", "view"])
def test_the_address_is_printed_and_opened(
        folder: Path, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    """Ctrl-C ends it with code 0; where the server runs is left to the tests of the server."""
    def interrupt(loop: IOLoop) -> None:
        raise KeyboardInterrupt

    opened: list[str] = []
    monkeypatch.setattr(IOLoop, "start", interrupt)
    monkeypatch.setattr("asyncio.base_events.BaseEventLoop.run_forever", interrupt)
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.chdir(folder)
    write_known(folder / "r.vtkhdf", Motion())
    arguments = ["draw", "f.tif"] if command == "draw" else ["view", "r.vtkhdf"]
    ran = CliRunner().invoke(command_line, arguments)
    assert ran.exit_code == 0, ran.output
    lines = ran.output.splitlines()
    found = re.fullmatch(r"page +(http://localhost:(\d+)/\?token=[\w-]{43})", lines[0])
    assert found
    assert opened == [found[1]]
    assert lines[1].endswith(f" ssh -L {found[2]}:localhost:{found[2]} THIS_MACHINE, then the same address")
    ran = CliRunner().invoke(command_line, [*arguments, "--no-browser"])
    assert ran.exit_code == 0
    assert len(opened) == 1
    assert not (folder / "case.toml").exists()


def test_a_notebook_shows_a_page(folder: Path) -> None:
    page = ddic.draw(folder / "f.tif", folder / "case.toml", [folder / "g.tif"])
    with urllib.request.urlopen(page.address, timeout=LIMIT) as answer:
        assert answer.status == 200
    shown = page._repr_html_()
    assert f'<iframe src="{page.address}" width="100%" height="{HEIGHT}"' in shown
    result = ddic.open(write_known(folder / "r.vtkhdf", Motion()))
    with urllib.request.urlopen(result.view().address, timeout=LIMIT) as answer:
        assert b"ddic view r.vtkhdf" in answer.read()
    assert NotebookPage('a"b')._repr_html_().count('a"b') == 0


def test_a_result_in_no_file_is_not_viewed(folder: Path) -> None:
    result = replace(ddic.open(write_known(folder / "r.vtkhdf", Motion())), path=Path())
    with pytest.raises(InputError, match=r'is in memory only.* measure with output="result\.vtkhdf", then view'):
        result.view()


def test_a_page_outlives_a_change_of_the_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What relative paths named is read later, too: the image in windows, the file before it is written."""
    made: list[DrawnCase] = []

    def keep(make_page: partial[None]) -> str:
        made.append(make_page.args[0])
        return ""

    monkeypatch.setattr("ddic.page.server.start_in_thread", keep)
    monkeypatch.chdir(folder)
    ddic.draw("f.tif", "case.toml", ["g.tif"])
    monkeypatch.chdir("/")
    (drawn,) = made
    assert 'reference = "f.tif"\ndeformed = "g.tif"' in drawn.text
    assert drawn.image.read((0.0, 0.0, 8.0, 8.0), 80, 80).grey.any()
    assert list(check_text(drawn.text, drawn).problems) == []
    CaseFile(drawn.path).write(drawn.text)
    assert (folder / "case.toml").is_file()


@pytest.mark.program
def test_a_page_is_served_until_it_is_interrupted(folder: Path) -> None:
    path = write_known(folder / "r.vtkhdf", Motion())
    with started([*DDIC, "view", str(path), "--no-browser"]) as process:
        assert process.stdout is not None
        told = [process.stdout.readline() for _ in range(3)]
        address = told[0].split()[1]
        with urllib.request.urlopen(address, timeout=LIMIT) as answer:
            assert b"ddic view r.vtkhdf" in answer.read()
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=LIMIT)
    assert process.returncode == 0, err
    assert err == ""
    assert "Ctrl-C" in told[2]

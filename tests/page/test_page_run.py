"""A case that is run from the page: what it prints, how it ends, how it is stopped, what is shown of it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from bokeh.document import Document
from bokeh.models import Button, PreText, Tabs

import ddic
from ddic.errors import InputError
from ddic.page import case_run
from ddic.page.case_run import MOST_SHOWN, CaseRun, RunBox
from ddic.page.draw import make_draw_page
from ddic.page.drawn_case import open_drawn_case
from support.cases import case_text
from support.commands import LIMIT, wait_for
from support.page_results import Content, Motion, write_known
from support.page_tab import Jobs, Tab
from support.patient import ENDLESS, FOUR, patient

Imitate = Callable[[str], None]


@pytest.fixture
def imitate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Imitate]:
    """Have a script of the shell run in the place of ``python -m ddic run case.toml``; none survives the test."""
    program = tmp_path / "imitated"
    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def note(*arguments: object, **options: object) -> subprocess.Popen[bytes]:
        started.append(popen(*arguments, **options))  # type: ignore[call-overload]
        return started[-1]

    def make(script: str) -> None:
        program.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
        program.chmod(0o700)
        monkeypatch.setattr(case_run.sys, "executable", str(program))
        monkeypatch.setattr(case_run.subprocess, "Popen", note)

    yield make
    for process in started:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def wait_until(condition: Callable[[], bool]) -> None:
    limit = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.01)


def ended(run: CaseRun) -> int | None:
    wait_until(lambda: not run.is_running)
    return run.exit_code


def test_a_run_says_what_it_prints_and_how_it_ended(tmp_path: Path, imitate: Imitate) -> None:
    imitate('echo "$@"; echo "on standard error" >&2; exit 7')
    run = CaseRun(tmp_path / "case.toml")
    assert (run.is_running, run.exit_code, run.read_log()) == (False, None, "")
    run.start(1)
    assert ended(run) == 7
    assert run.read_log() == f"-m ddic run {tmp_path / 'case.toml'}\non standard error\n"


def test_of_much_that_is_printed_the_end_is_shown(tmp_path: Path, imitate: Imitate) -> None:
    """Also where it begins in the middle of a letter."""
    imitate("for i in 1 2 3 4 5 6 7 8 9 10; do printf '%4000s' x | sed 's/ /ä/g'; done; echo end")
    run = CaseRun(tmp_path / "case.toml")
    run.start(1)
    assert ended(run) == 0
    log = run.read_log()
    assert log.endswith("äx" + "end\n") or log.endswith("xend\n")
    assert len(log.encode()) <= MOST_SHOWN + 3
    assert MOST_SHOWN // 2 - 20 < len(log) < MOST_SHOWN


def test_a_second_start_is_refused(tmp_path: Path, imitate: Imitate) -> None:
    imitate("sleep 60")
    run = CaseRun(tmp_path / "case.toml")
    run.start(1)
    with pytest.raises(InputError, match=r"case.toml: is running already"):
        run.start(1)
    assert run.is_running


def test_it_is_asked_to_stop_by_the_signal_that_keeps_the_field(tmp_path: Path, imitate: Imitate) -> None:
    imitate(f"trap 'echo asked; exit 3' USR1; touch {tmp_path}/ready; while true; do sleep 0.02; done")
    run = CaseRun(tmp_path / "case.toml")
    # Nothing runs: nobody is asked.
    run.stop()
    run.start(1)
    wait_for(tmp_path / "ready")
    run.stop()
    assert ended(run) == 3
    assert run.read_log() == "asked\n"
    run.stop()


def test_ranks_are_started_by_the_launcher(tmp_path: Path, imitate: Imitate, monkeypatch: pytest.MonkeyPatch) -> None:
    imitate("echo ranks")
    launcher = tmp_path / "launcher"
    launcher.write_text('#!/bin/sh\necho "launched: $1 $2"\nshift 2\nexec "$@"\n', encoding="utf-8")
    launcher.chmod(0o700)
    monkeypatch.setenv("MPIEXEC", str(launcher))
    run = CaseRun(tmp_path / "case.toml")
    run.start(3)
    assert ended(run) == 0
    assert run.read_log() == "launched: -n 3\nranks\n"
    run.start(1)
    assert ended(run) == 0
    assert run.read_log() == "ranks\n"
    monkeypatch.setenv("MPIEXEC", "absent_launcher")
    with pytest.raises(InputError, match="absent_launcher: not found, for 3 ranks; run on one"):
        run.start(3)


class Box:
    """The buttons of a run on a page of their own."""

    def __init__(self, run: CaseRun, *, writes: bool = True) -> None:
        self.told: list[str] = []
        self.finished = 0
        self.written = 0

        def write() -> bool:
            self.written += 1
            return writes

        def finish() -> None:
            self.finished += 1

        def make(document: Document) -> None:
            box = RunBox(run, document, write, finish, self.told.extend)
            for control in (*box.controls, box.log):
                document.add_root(control)

        self.tab = Tab(make, [])

    @property
    def log(self) -> str:
        return str(self.tab.find(PreText).text)

    def is_open(self, label: str) -> bool:
        return not self.tab.find(Button, label=label).disabled


def test_buttons_follow_the_run_in_all_tabs(tmp_path: Path, imitate: Imitate) -> None:
    imitate(f"trap 'exit 3' USR1; echo begun; touch {tmp_path}/ready; while true; do sleep 0.02; done")
    run = CaseRun(tmp_path / "case.toml")
    one, other = Box(run), Box(run)
    for box in (one, other):
        box.tab.poll()
        assert (box.is_open("Run"), box.is_open("Stop, keep the field")) == (True, False)
    one.tab.press("Run")
    wait_for(tmp_path / "ready")
    for box in (one, other):
        box.tab.poll()
        assert (box.is_open("Run"), box.is_open("Stop, keep the field")) == (False, True)
        assert box.log == "begun\n"
    assert (one.written, other.written) == (1, 0)
    other.tab.press("Stop, keep the field")
    assert ended(run) == 3
    for box in (one, other):
        box.tab.poll()
        box.tab.poll()
        assert (box.is_open("Run"), box.is_open("Stop, keep the field")) == (True, False)
        assert box.finished == 1


@pytest.mark.parametrize(("code", "finished"), [(0, 1), (1, 1), (2, 0), (3, 1), (130, 0)])
def test_a_run_that_ends_before_it_is_looked_at_is_seen_too(
        tmp_path: Path, imitate: Imitate, code: int, finished: int) -> None:
    """As one that is refused at once: its log says why. There may be a result after some codes alone."""
    imitate(f"echo 'why it ended'; exit {code}")
    run = CaseRun(tmp_path / "case.toml")
    box = Box(run)
    box.tab.press("Run")
    assert ended(run) == code
    box.tab.poll()
    assert box.log == "why it ended\n"
    assert box.finished == finished
    box.tab.poll()
    assert box.finished == finished


def test_what_cannot_be_started_is_told(tmp_path: Path, imitate: Imitate, monkeypatch: pytest.MonkeyPatch) -> None:
    imitate("exit 0")
    run = CaseRun(tmp_path / "case.toml")
    box = Box(run)
    monkeypatch.setenv("MPIEXEC", "absent_launcher")
    box.tab.widget("Ranks").value = 2
    box.tab.press("Run")
    assert box.told == ["absent_launcher: not found, for 2 ranks; run on one"]
    unwritten = Box(run, writes=False)
    unwritten.tab.press("Run")
    assert unwritten.written == 1
    assert run.exit_code is None


# On the page of a case.


def open_page(folder: Path, jobs: Jobs, text: str) -> tuple[Tab, CaseRun]:
    (folder / "case.toml").write_text(text, encoding="utf-8")
    drawn = open_drawn_case(folder / "f.tif", folder / "case.toml")
    return Tab(partial(make_draw_page, drawn), jobs), drawn.run


def shown_tabs(tab: Tab) -> list[str]:
    return [panel.title for panel in tab.find(Tabs).tabs]


@pytest.mark.parametrize("name", ["result.vtkhdf", "result.not_converged.vtkhdf"])
def test_what_was_measured_is_shown_beside_the_drawing(folder: Path, jobs: Jobs, imitate: Imitate, name: str) -> None:
    """The result, or the last field where it did not converge, with the probes of the drawing."""
    made = write_known(folder / "made", Motion(), Content((folder / "f.tif", folder / "g.tif")))
    imitate(f"cp {made} {folder / name}")
    tab, run = open_page(folder, jobs, case_text())
    tab.draw("probe: point", [(96.0, 96.0)])
    tab.press("Run")
    assert ended(run) == 0
    tab.poll()
    tab.settle()
    assert shown_tabs(tab) == ["Draw", "Result"]
    assert tab.find(Tabs).active == 1
    assert f"{name}, time 2.5" in tab.texts()
    # u of the middle, as the probe of the drawing reads it.
    assert "<td>point_1</td><td>0.4</td><td>-0.3</td>" in tab.texts()


def test_an_earlier_result_is_not_taken_for_the_new_one(folder: Path, jobs: Jobs, imitate: Imitate) -> None:
    """A run that crashes leaves the one before where it was."""
    earlier = write_known(folder / "result.vtkhdf", Motion())
    an_hour_ago = time.time() - 3600.0
    os.utime(earlier, (an_hour_ago, an_hour_ago))
    imitate("exit 1")
    tab, run = open_page(folder, jobs, case_text())
    tab.press("Run")
    assert ended(run) == 1
    tab.poll()
    assert shown_tabs(tab) == ["Draw"]


def test_what_is_run_is_what_the_page_shows(folder: Path, jobs: Jobs, imitate: Imitate) -> None:
    imitate(f"cp {folder}/case.toml {folder}/seen.toml")
    tab, run = open_page(folder, jobs, case_text())
    tab.enter("Element size (px)", 12)
    tab.press("Run")
    assert ended(run) == 0
    assert (folder / "seen.toml").read_text(encoding="utf-8") == case_text().replace("= 16", "= 12")
    # What others have written since is neither written over nor run.
    (folder / "case.toml").write_text("title = 'of somebody else'\n", encoding="utf-8")
    (folder / "seen.toml").unlink()
    tab.poll()
    tab.press("Run")
    assert not (folder / "seen.toml").exists()
    assert "was changed since this page was opened" in tab.texts()


# Whole programs.


@pytest.mark.program
def test_a_case_is_measured_from_the_page(folder: Path, jobs: Jobs) -> None:
    tab, run = open_page(folder, jobs, case_text('[solver]\nmethod = "monolithic"\n'))
    tab.press("Run")
    assert ended(run) == 0
    tab.poll()
    assert "written" in tab.find(PreText).text or "result" in tab.find(PreText).text
    assert shown_tabs(tab) == ["Draw", "Result"]
    assert ddic.open(folder / "result.vtkhdf").converged


@pytest.mark.program
def test_a_case_that_is_refused_says_why(folder: Path, jobs: Jobs) -> None:
    tab, run = open_page(folder, jobs, case_text())
    # After the page has checked the case.
    (folder / "g.tif").unlink()
    tab.press("Run")
    assert ended(run) == 2
    tab.poll()
    assert "g.tif: no such image file" in tab.find(PreText).text
    assert shown_tabs(tab) == ["Draw"]


@pytest.mark.program
def test_a_run_that_is_stopped_keeps_its_field(folder: Path, jobs: Jobs, imitate: Imitate) -> None:
    tab, run = open_page(folder, jobs, case_text(FOUR + ENDLESS))
    imitate("exec " + " ".join(patient(folder)))
    tab.press("Run")
    wait_for(folder.parent / "iterating*")
    tab.poll()
    tab.press("Stop, keep the field")
    assert ended(run) == 3
    with pytest.warns(UserWarning, match="did not converge"):
        tab.poll()
    assert "stopped by a signal after iteration" in tab.find(PreText).text
    assert "result.not_converged.vtkhdf, time 1" in tab.texts()


@pytest.mark.program
def test_a_run_outlives_its_page(tmp_path: Path) -> None:
    """Ctrl-C reaches the page's whole group of processes, and a kill the page: neither ends the measurement."""
    program = tmp_path / "imitated"
    program.write_text(f"#!/bin/sh\ntouch {tmp_path}/begun\nfor i in $(seq 3000); do test -e {tmp_path}/go && break; "
                       f"sleep 0.02; done\ntouch {tmp_path}/ended\n", encoding="utf-8")
    program.chmod(0o700)
    page = ("import sys, time\nfrom pathlib import Path\nfrom ddic.page.case_run import CaseRun\n"
            f"sys.executable = {str(program)!r}\nrun = CaseRun(Path('case.toml'))\nrun.start(1)\ntime.sleep(60)\n")
    process = subprocess.Popen([sys.executable, "-c", page], start_new_session=True, stderr=subprocess.DEVNULL)
    try:
        wait_for(tmp_path / "begun")
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(LIMIT) != 0
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    assert not (tmp_path / "ended").exists()
    (tmp_path / "go").touch()
    wait_for(tmp_path / "ended")

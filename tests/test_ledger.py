"""Acceptance tables: what tiny cases judge, what the ledger keeps, and which rows are older than their code."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import pytest

from accept import all_tables, ledger, smoke, table
from accept.all_tables import Stale
from accept.ledger import Entry, forget_all_but, keep_rows, read_ledger
from accept.near_far import measure_dual
from accept.pages import measure_equations
from accept.support.code_of_check import choose, find_changed, find_code, find_uncommitted
from accept.support.settings import MONOLITHIC, describe_settings
from accept.table import Check, Scale, run_table
from accept.tables import TABLES, find_checks
from bench.support.rows import Row
from bench.support.runs import ROOT, NotHereError

HOLDS, MISSES = Row("an error", "<= 1 px", "0.5 px", True), Row("an error", "<= 1 px", "2 px", False)
SLOW = Row("a time", "<= 1 s", "2 s", False, judged_small=False)


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """The checks whose rows enter the ledger; nothing is written into this repository."""
    found: list[tuple[str, str]] = []
    monkeypatch.setattr(table, "RESULTS", tmp_path)
    monkeypatch.setattr(table, "append_result", lambda *_: None)
    monkeypatch.setattr(table, "find_code", lambda _: frozenset({"tests"}))
    monkeypatch.setattr(table, "find_uncommitted", lambda _: frozenset({"README.md"}))
    monkeypatch.setattr(table, "keep_rows", lambda check, *_: found.append(check))
    return found


def _check(*rows: Row, error: Exception | None = None) -> Check:
    def measure(_: Scale) -> Sequence[Row]:
        if error is not None:
            raise error
        return rows

    return measure


@pytest.mark.parametrize(("check", "code", "printed"), [
    (_check(HOLDS, SLOW), 0, ("holds  some: an error", "ran    some: a time")),
    (_check(HOLDS, MISSES), 1, ("holds  some: an error", "FAILS  some: an error: 2 px (bound: <= 1 px)")),
    (_check(error=NotHereError("no images")), 0, ("ran    some: some: not measured: no images",)),
    (_check(error=ZeroDivisionError("0")), 1, ("FAILED some: some: could not be measured: ZeroDivisionError: 0",))])
def test_tiny_cases_judge_what_holds_there(check: Check, code: int, printed: tuple[str, ...], kept: list[object],
                                           capsys: pytest.CaptureFixture[str]) -> None:
    assert run_table("none", {"some": check}, ["--smoke"]) == code
    shown = capsys.readouterr().out
    assert all(line in shown for line in printed)
    assert not kept


@pytest.mark.parametrize(("check", "code", "is_kept"), [
    (_check(HOLDS), 0, True), (_check(HOLDS, SLOW), 1, True), (_check(error=ZeroDivisionError("0")), 1, True),
    (_check(error=NotHereError("no images")), 1, False)])
def test_whole_cases_judge_all_and_enter_the_ledger(check: Check, code: int, is_kept: bool,
                                                    kept: list[tuple[str, str]]) -> None:
    assert run_table("none", {"some": check}, []) == code
    assert kept == [("none", "some")] * is_kept


def test_rows_of_uncommitted_code_are_not_kept(kept: list[tuple[str, str]], monkeypatch: pytest.MonkeyPatch,
                                               capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(table, "find_uncommitted", lambda _: frozenset({"tests/test_ledger.py", "README.md"}))
    assert run_table("none", {"some": _check(HOLDS)}, []) == 0
    assert not kept
    assert "differ from the last commit (tests/test_ledger.py)" in capsys.readouterr().out


def test_the_ledger_replaces_the_rows_of_a_check(tmp_path: Path) -> None:
    path = tmp_path / "ledger.json"
    assert read_ledger(path) == []
    keep_rows(("start", "b"), [HOLDS, MISSES], "1234", 2.04, path)
    keep_rows(("start", "a"), [HOLDS], "1234", 1.0, path)
    keep_rows(("start", "b"), [SLOW], "5678", 3.0, path)
    entries = read_ledger(path)
    assert [(e.check, e.value, e.holds, e.commit, e.seconds) for e in entries] == [
        ("a", "0.5 px", True, "1234", 1.0), ("b", "2 s", False, "5678", 3.0)]
    # A row a line, so that two branches that measured different checks merge.
    assert len(path.read_text(encoding="utf-8").splitlines()) == len(entries) + 2
    forget_all_but([("start", "b")], path)
    assert [e.check for e in read_ledger(path)] == ["b"]


def test_missing_and_missed_rows_are_judged(monkeypatch: pytest.MonkeyPatch,
                                            capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(all_tables, "list_checks", lambda: [("start", "a"), ("start", "b")])
    monkeypatch.setattr(all_tables, "list_stale", lambda _: [])
    monkeypatch.setattr(all_tables, "OPEN", {})
    a, b = (Entry("start", name, "an error", "<= 1 px", "2 px", name == "a", "1234", "2026-01-01", 1.0)
            for name in "ab")
    assert all_tables.judge([a]) == 1
    assert "missing: make accept-start CHECK=b" in capsys.readouterr().out
    assert all_tables.judge([a, b]) == 1
    assert "make accept-start CHECK=b, at 1234" in capsys.readouterr().out
    held = Entry(**{**vars(b), "holds": True})
    assert all_tables.judge([a, held]) == 0
    # What is explained passes, for as long as it misses its bound.
    monkeypatch.setattr(all_tables, "OPEN", {("start", "b"): "the sea is rough"})
    assert all_tables.judge([a, b]) == 0
    assert "the sea is rough" in capsys.readouterr().out
    assert all_tables.judge([a, held]) == 1
    assert "start b; remove it from accept/open_rows.py" in capsys.readouterr().out
    assert all_tables.judge([a]) == 1


def test_rows_of_other_code_than_the_last_commit_s_are_counted(monkeypatch: pytest.MonkeyPatch,
                                                               capsys: pytest.CaptureFixture[str]) -> None:
    a = Entry("start", "a", "an error", "<= 1 px", "0.5 px", True, "1234", "2026-01-01", 1.0)
    monkeypatch.setattr(all_tables, "list_checks", lambda: [("start", "a")])
    monkeypatch.setattr(all_tables, "OPEN", {})
    monkeypatch.setattr(all_tables, "list_stale", lambda _: [Stale(("start", "a"), a, ["src/ddic/errors.py"])])
    assert all_tables.judge([a]) == 0
    assert "1 are older than their code" in capsys.readouterr().out


@pytest.mark.parametrize(("printed", "failed", "code", "told"), [
    ("holds  a: row\nholds  a: row\nran    b: row\n", 0, 0, "2 of 3 rows judged (67%; at least 60%), 2 hold"),
    ("holds  a: row\nholds  a: row\nran    b: row\ntold   b: row\n", 0, 0, "2 of 3 rows judged"),
    ("holds  a: row\nran    b: row\n", 0, 1, "1 of 2 rows judged (50%; at least 60%), 1 hold"),
    ("holds  a: row\nFAILS  b: row\n", 1, 1, "does not hold: start"),
    ("FAILED a: row\n", 1, 1, "1 of 1 rows judged (100%; at least 60%), 0 hold")])
def test_the_smoke_run_counts_what_it_judges(printed: str, failed: int, code: int, told: str,
                                             monkeypatch: pytest.MonkeyPatch,
                                             capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(smoke, "_run_table", lambda _: (failed, printed))
    assert smoke.run_smoke(["start"]) == code
    assert told in capsys.readouterr().out


def test_settings_are_told_as_in_a_case_file() -> None:
    options = {**MONOLITHIC, "discontinuity": [{"vertices": []}], "correlation": {"spoilt_pixels": "keep"}}
    told = 'solver.method = "monolithic", correlation.spoilt_pixels = "keep"'
    assert describe_settings(options) == told
    text = '[images]\nreference = "f.tif"\n[solver]\nmethod = "monolithic"\n[correlation]\nspoilt_pixels = "keep"\n'
    assert describe_settings(text) == told


def test_only_what_is_missing_or_stale_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    checks = {"fresh": _check(), "stale": _check(), "lost": _check(), "missing": _check()}
    entries = [Entry("start", name, "", "", "", True, commit, "2026-01-01", 1.0)
               for name, commit in (("fresh", "new"), ("stale", "old"), ("lost", "unknown"), ("gone", "new"))]
    changed = {"new": frozenset({"README.md"}), "old": frozenset({"tests/test_ledger.py"}), "unknown": None}
    measured: list[tuple[str, str]] = []
    monkeypatch.setattr(all_tables, "TABLES", ("start",))
    monkeypatch.setattr(all_tables, "find_checks", lambda _: checks)
    monkeypatch.setattr(all_tables, "find_code", lambda _: frozenset({"tests"}))
    monkeypatch.setattr(all_tables, "find_changed", changed.__getitem__)
    monkeypatch.setattr(all_tables, "find_uncommitted", frozenset[str])
    monkeypatch.setattr(all_tables, "read_ledger", lambda: entries)
    monkeypatch.setattr(all_tables, "forget_all_but", lambda _: None)
    monkeypatch.setattr(all_tables, "measure", lambda wanted, _: measured.extend(wanted))
    assert all_tables.main(["stale"]) == 0
    assert not measured
    all_tables.main(["stale", "--run"])
    assert {name for _, name in measured} == {"stale", "lost"}
    measured.clear()
    all_tables.main(["run"])
    assert {name for _, name in measured} == {"stale", "lost", "missing"}
    monkeypatch.setattr(all_tables, "find_uncommitted", lambda: frozenset({"src/ddic/errors.py"}))
    assert all_tables.main(["run"]) == 2


def test_a_check_runs_what_it_imports_starts_and_reads() -> None:
    code = find_code(partial(measure_dual))
    assert {"accept/near_far.py", "accept/support/near_far_job.py",
            "src/ddic/cli/run.py", "src/ddic/solvers/__init__.py"} <= code
    assert "accept/ledger.py" not in code
    pages = find_code(measure_equations)
    assert "docs" in pages
    assert not any(file.startswith("src/") for file in pages)
    assert choose(frozenset({"docs/start.md", "src/ddic/errors.py", "accept/ledger.json"}), pages) == ["docs/start.md"]


def test_every_table_has_a_target_and_checks() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for name in TABLES:
        assert f"accept-{name}:" in makefile
        assert find_checks(name)


@pytest.fixture
def repository(tmp_path: Path) -> tuple[Path, Callable[[str], str]]:
    """A repository with a commit, and what commits another text of its file."""
    def git(*arguments: str) -> str:
        who = ("-c", "user.name=nobody", "-c", "user.email=nobody@example.org")
        return subprocess.run(["git", "-C", str(tmp_path), *who, *arguments], check=True, capture_output=True,
                              text=True).stdout.strip()

    def commit(text: str) -> str:
        (tmp_path / "a.py").write_text(text, encoding="utf-8")
        git("add", "-A")
        git("commit", "-qm", "change")
        return git("rev-parse", "HEAD")

    git("init", "-q")
    return tmp_path, commit


def test_comments_and_docstrings_are_no_change(repository: tuple[Path, Callable[[str], str]]) -> None:
    root, commit = repository
    first = commit('"""Text."""\n\n\ndef double(a):\n    """Double a."""\n    return 2 * a\n')
    second = commit('"""Other text."""\n\n\ndef double(a):\n    # By two.\n    return 2 * a\n')
    assert find_changed(first, root) == frozenset()
    find_changed.cache_clear()
    commit("def double(a):\n    return a + a\n")
    assert find_changed(second, root) == {"a.py"}
    assert find_changed("0123456789" * 4, root) is None
    (root / "a.py").write_text("def double(a):\n    return 2 * a\n", encoding="utf-8")
    (root / "b.py").write_text("b = 1\n", encoding="utf-8")
    assert find_uncommitted(root=root) == {"a.py", "b.py"}
    assert find_uncommitted(second, root) == {"b.py"}


def test_the_ledger_of_this_repository_can_be_read() -> None:
    assert all(isinstance(entry, Entry) for entry in read_ledger(ledger.LEDGER))

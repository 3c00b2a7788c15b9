import os

import pytest

from ddic.cli.entry import TIMEOUT, prepare_idle_threads

NAME = "OPENBLAS_THREAD_TIMEOUT"


def test_threads_sleep_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(NAME, "")
    monkeypatch.delenv(NAME)
    prepare_idle_threads()
    assert os.environ[NAME] == TIMEOUT


def test_what_the_environment_says_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(NAME, "26")
    prepare_idle_threads()
    assert os.environ[NAME] == "26"

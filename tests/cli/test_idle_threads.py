import os

import pytest

from ddic.cli.idle_threads import TIMEOUT, let_idle_threads_sleep

NAME = "OPENBLAS_THREAD_TIMEOUT"


def test_threads_sleep_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(NAME, "")
    monkeypatch.delenv(NAME)
    let_idle_threads_sleep()
    assert os.environ[NAME] == TIMEOUT


def test_what_the_environment_says_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(NAME, "26")
    let_idle_threads_sleep()
    assert os.environ[NAME] == "26"

import os

import pytest

from ddic.cli.run import ALONE, COUNTS, ON_ONE_NODE, _no_needless_networks

RANKS = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK", "SLURM_PROCID")


@pytest.fixture(autouse=True)
def _no_launcher(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (*RANKS, *COUNTS, *ALONE):
        monkeypatch.delenv(name, raising=False)


def test_no_networks_without_a_launcher_and_the_environment_is_as_before() -> None:
    with _no_needless_networks():
        assert {name: os.environ.get(name) for name in ALONE} == ALONE
    assert not any(name in os.environ for name in ALONE)


@pytest.mark.parametrize("name", RANKS)
def test_a_rank_of_a_job_keeps_its_networks(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(name, "0")
    with _no_needless_networks():
        assert not any(setting in os.environ for setting in ALONE)


def test_what_the_environment_says_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    name = "OMPI_MCA_btl"
    monkeypatch.setenv(name, "tcp,self")
    with _no_needless_networks():
        assert os.environ[name] == "tcp,self"
    assert os.environ[name] == "tcp,self"


@pytest.mark.parametrize(("n_here", "settings"), [("4", ON_ONE_NODE), ("2", {})])
def test_ranks_of_one_node_look_for_no_networks(n_here: str, settings: dict[str, str],
                                                monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in zip((RANKS[0], *COUNTS), ("0", "4", n_here), strict=True):
        monkeypatch.setenv(name, value)
    with _no_needless_networks():
        assert {name: os.environ[name] for name in ALONE if name in os.environ} == settings
    assert not any(name in os.environ for name in ALONE)

"""Ranks on two hosts, between which everything crosses a network: ``make test-hosts``; takes root."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import ddic
from accept.series_runs import find_unequal_datasets
from support.cases import write_case, write_images
from support.commands import DDIC
from support.commands import ddic as run_ddic
from support.patient import ENDLESS, FOUR, patient
from support.two_hosts import TwoHosts, two_hosts

pytestmark = pytest.mark.skipif("DDIC_TEST_HOSTS" not in os.environ, reason="make test-hosts runs it")

WHO = """
from mpi4py import MPI
import socket
comm = MPI.COMM_WORLD
hosts = comm.gather((socket.gethostname(), comm.Split_type(MPI.COMM_TYPE_SHARED).size))
if comm.rank == 0:
    print(*(f"{name}:{size}" for name, size in hosts))
"""


@pytest.fixture(scope="module")
def hosts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TwoHosts]:
    with two_hosts(tmp_path_factory.mktemp("hosts")) as both:
        yield both


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    inner = tmp_path / "run"
    inner.mkdir()
    write_images(inner)
    write_case(inner, FOUR)
    return inner


@pytest.mark.parametrize("ranks", [(1, 1), (2, 1), (2, 2)])
def test_hosts_share_no_memory(hosts: TwoHosts, ranks: tuple[int, int]) -> None:
    done = hosts.run(ranks, sys.executable, "-c", WHO)
    assert done.returncode == 0, done.stderr
    first, second = ranks
    assert done.stdout.split() == [f"host1:{first}"] * first + [f"host2:{second}"] * second


@pytest.mark.parametrize(("ranks", "more"), [
    ((1, 1), "[regularization]\ncut_off_wavelength = 48.0\n"), ((2, 2), ""), ((1, 1), "[pgd]\n")],
    ids=["regularized", "dual", "pgd"])
def test_the_result_is_that_of_one_host(hosts: TwoHosts, folder: Path, ranks: tuple[int, int], more: str) -> None:
    write_case(folder, more if "pgd" in more else FOUR + more)
    alone = folder.with_name("alone")
    shutil.copytree(folder, alone)
    assert run_ddic("run", alone / "case.toml", ranks=sum(ranks)).code == 0
    before = hosts.count_bytes()
    done = hosts.run(ranks, *DDIC, "run", str(folder / "case.toml"))
    assert done.returncode == 0, done.stderr
    # At least the fields of the second host's half have come over the wire to be written: 100 nodes of two floats.
    assert hosts.count_bytes() - before > 1600
    _, unequal = find_unequal_datasets(alone / "result.vtkhdf", folder / "result.vtkhdf")
    assert unequal == []


def test_compressed_images_are_shared_by_each_hosts_ranks(hosts: TwoHosts, folder: Path) -> None:
    import cv2
    import tifffile

    for name in ("f", "g"):
        cv2.imwrite(str(folder / f"{name}.png"), tifffile.imread(folder / f"{name}.tif"))
    case = folder / "case.toml"
    results = []
    for kind in ("tif", "png"):
        case.write_text(case.read_text().replace(".tif", f".{kind}"), encoding="utf-8")
        done = hosts.run((2, 2), *DDIC, "run", str(case))
        assert done.returncode == 0, done.stderr
        results.append(ddic.open(folder / "result.vtkhdf").displacement)
    assert (results[0] == results[1]).all()


def test_a_refused_case_ends_both_hosts(hosts: TwoHosts, folder: Path) -> None:
    write_case(folder, FOUR.replace("subdomains", "subdomain"))
    done = hosts.run((1, 1), *DDIC, "run", str(folder / "case.toml"))
    assert done.returncode == 2
    assert "solver.subdomain: unknown key" in done.stderr


def test_a_failure_on_the_second_host_ends_both(hosts: TwoHosts, folder: Path) -> None:
    write_case(folder, FOUR + ENDLESS)
    program = patient(folder, 0.1)
    script = Path(program[-1])
    script.write_text(script.read_text().replace(
        "        return linearize(model, q)",
        "            if str(rank) == '1': os.kill(os.getpid(), 9)\n        return linearize(model, q)"),
        encoding="utf-8")
    done = hosts.run((1, 1), *program, seconds=60.0)
    assert done.returncode != 0
    assert not (folder / "result.vtkhdf").exists()


def test_a_signal_to_the_second_host_stops_both(hosts: TwoHosts, folder: Path) -> None:
    write_case(folder, FOUR + ENDLESS)
    program = patient(folder, 0.1)
    script = Path(program[-1])
    script.write_text(script.read_text().replace(
        "        return linearize(model, q)",
        "            if str(rank) == '1': os.kill(os.getpid(), 10)\n        return linearize(model, q)"),
        encoding="utf-8")
    done = hosts.run((1, 1), *program, seconds=60.0)
    assert done.returncode == 3, done.stderr
    with pytest.warns(UserWarning, match="did not converge"):
        assert not ddic.open(folder / "result.not_converged.vtkhdf").converged

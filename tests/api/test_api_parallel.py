"""The Python interface under mpirun: every rank gets the whole result, and every error."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

import ddic
from ddic.errors import is_collective
from support.small_pair import REGULARIZED, TIGHT, WITHIN, largest_error, move

Pair = tuple[NDArray[np.uint8], NDArray[np.uint8]]
EXAMPLES = Path(__file__).parents[2] / "examples"


def same_on_all_ranks(array: NDArray[Any]) -> bool:
    first = MPI.COMM_WORLD.bcast(array)
    return all(MPI.COMM_WORLD.allgather(np.array_equal(array, first, equal_nan=True)))


def refused(call: Any) -> ddic.InputError:
    """The error, which every rank raises as one that all ranks have."""
    error: Exception | None = None
    try:
        call()
    except Exception as caught:
        error = caught
    told = MPI.COMM_WORLD.allgather((type(error).__name__, str(error), error is not None and is_collective(error)))
    assert told[0][0] == "InputError"
    assert all(of_rank == told[0] for of_rank in told)
    assert isinstance(error, ddic.InputError)
    return error


@pytest.mark.parallel([3])
def test_every_rank_gets_the_whole_result(pair: Pair, mesh: ddic.Mesh, shared_path: Path) -> None:
    options = REGULARIZED | {"solver": {"subdomains": 4}}
    result = ddic.measure(pair, mesh, **options, output=shared_path / "result.vtkhdf")
    alone = ddic.measure(pair, mesh, comm=MPI.COMM_SELF, **options)
    MPI.COMM_WORLD.barrier()
    read = ddic.open(shared_path / "result.vtkhdf")
    assert result.mesh.n_nodes == mesh.n_nodes
    assert same_on_all_ranks(result.displacement)
    assert result.residual_image is not None
    assert same_on_all_ranks(result.residual_image)
    assert largest_error(result) < WITHIN
    assert np.abs(result.displacement - alone.displacement).max() < 1e-6
    assert np.array_equal(read.displacement, result.displacement)


@pytest.mark.filterwarnings("ignore:.*did not converge:UserWarning")
@pytest.mark.parallel([3])
@pytest.mark.parametrize("options", [
    REGULARIZED | {"solver": {"method": "dual", "subdomains": 4}, "gauss_newton": {"max_iterations": 1}},
    {"pgd": {"max_corrections": 1, "stop_at_noise": False}}], ids=["dual", "pgd"])
def test_every_rank_gets_the_last_field_of_a_failure(pair: Pair, mesh: ddic.Mesh, shared_path: Path,
                                                     options: dict[str, Any]) -> None:
    options = options | {"start": {"pyramid": False}}
    with ddic.prepare(pair[0], mesh, **options) as session:
        # Identical images need one iteration, and no correction of those that are counted.
        first = session.measure(pair[0], output=shared_path / "first.vtkhdf") if "pgd" not in options else None
        with pytest.raises(ddic.ConvergenceError) as caught:
            session.measure(pair[1], output=shared_path / "second.vtkhdf")
    assert is_collective(caught.value)
    result = caught.value.result
    assert same_on_all_ranks(result.displacement)
    assert len(set(MPI.COMM_WORLD.allgather(str(caught.value)))) == 1
    assert np.array_equal(ddic.open(shared_path / "second.not_converged.vtkhdf").displacement, result.displacement)
    if first is not None:
        assert np.array_equal(ddic.open(shared_path / "first.vtkhdf").displacement, first.displacement)


@pytest.mark.parallel([2])
def test_files_masks_and_sessions(files: tuple[Path, Path], pair: Pair, mesh: ddic.Mesh) -> None:
    mask = np.ones(pair[0].shape)
    mask[50:70, 60:75] = 0
    with ddic.prepare(ddic.Image(files[0], mask), mesh, **(REGULARIZED | {"solver": {"subdomains": 4}})) as session:
        first = session.measure(files[1])
        last = session.measure(ddic.Image(pair[1], mask), from_last=True)
        counts = MPI.COMM_WORLD.allgather((session.n_assembled, session.n_factorized))
    assert counts == [(2, 2), (2, 2)]
    assert largest_error(first) < WITHIN
    assert largest_error(last) < WITHIN


@pytest.mark.parallel([3])
def test_case_file(case_file: Path, shared_path: Path) -> None:
    result = ddic.measure(case_file, output=shared_path / "of_case.vtkhdf")
    assert largest_error(result) < WITHIN
    assert same_on_all_ranks(result.displacement)


@pytest.mark.parallel([2])
def test_ranks_can_measure_different_images_alone(pair: Pair, mesh: ddic.Mesh) -> None:
    deformed = pair[MPI.COMM_WORLD.rank]
    result = ddic.measure((pair[0], deformed), mesh, comm=MPI.COMM_SELF)
    MPI.COMM_WORLD.barrier()
    assert (np.abs(result.displacement).max() < 1e-4) == (MPI.COMM_WORLD.rank == 0)


@pytest.mark.parallel([3])
def test_wrong_input_is_told_on_all_ranks(pair: Pair, mesh: ddic.Mesh) -> None:
    nan = np.where(np.arange(160) == 60, np.nan, pair[0])
    refused(lambda: ddic.measure((nan, pair[1]), mesh))
    refused(lambda: ddic.measure((pair[0], pair[1][:99]), mesh))
    refused(lambda: ddic.measure((pair[0], "no_such.tif"), mesh))
    refused(lambda: ddic.measure((ddic.Image(pair[0], mask=np.ones(3)), pair[1]), mesh))
    refused(lambda: ddic.measure(pair, (mesh.nodes + 100, mesh.cells)))
    refused(lambda: ddic.measure(pair, "mesh.msh"))  # type: ignore[arg-type]
    refused(lambda: ddic.measure(pair, mesh, solver={"subdomains": 1}))
    refused(lambda: ddic.measure(pair, mesh, solver={"method": "monolithic"}))
    refused(lambda: ddic.measure(pair, mesh, solvr={}))
    refused(lambda: ddic.measure(pair, mesh, kinematics=lambda given: None))  # type: ignore[arg-type,return-value]
    refused(lambda: ddic.measure(pair, mesh, output="no_such_folder/r.vtkhdf"))
    refused(lambda: ddic.measure("no_such.toml"))


@pytest.mark.parallel([3])
def test_image_that_is_wrong_on_one_rank_is_told_on_all(pair: Pair, mesh: ddic.Mesh) -> None:
    reference = pair[0].astype(float)
    if MPI.COMM_WORLD.rank == 1:
        reference[3, 3] = np.nan
    assert "NaN" in str(refused(lambda: ddic.measure((reference, pair[1]), mesh)))


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("name", ["integrated_dic", "fixed_components"])
def test_own_kinematics_of_the_examples_by_every_method(name: str) -> None:
    example = runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="example")
    images, mesh, kinematics = (example[name] for name in ("IMAGES", "MESH", "kinematics"))

    def measure(solver: dict[str, Any], comm: MPI.Comm) -> NDArray[np.float64]:
        return ddic.measure(images, mesh, kinematics=kinematics, comm=comm, solver=solver,
                            gauss_newton=TIGHT).displacement

    alone = measure({"method": "monolithic"}, MPI.COMM_SELF)
    differences = {}
    for method in ("dual", "assembled", "conjugate_gradient"):
        found = measure({"method": method, "subdomains": 4, "tolerance": 1e-12}, MPI.COMM_WORLD)
        differences[method] = np.abs(found - alone).max()
    assert max(differences.values()) < 1e-9, differences


@pytest.mark.parallel([3])
def test_a_masked_image_without_regularization_is_prepared_on_all_ranks(pair: Pair, mesh: ddic.Mesh) -> None:
    used = np.ones(pair[0].shape, dtype=bool)
    used[35:105, 55:125] = False
    with ddic.prepare(ddic.Image(pair[0], used), mesh, solver={"subdomains": 4}) as session:
        result = session.measure(pair[1])
    assert same_on_all_ranks(result.displacement)
    assert np.isnan(result.displacement).any(axis=1).sum() == 4
    assert np.nanmax(np.abs(result.displacement - move(result.mesh.nodes))) < 2 * WITHIN

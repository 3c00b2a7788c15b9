from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from ddic.errors import InputError
from ddic.io.result_schema import summary_path
from ddic.results.summary import FieldRanges, Summary, write_summary


def summary() -> Summary:
    return Summary(
        converged=True, iterations=2, residual_std_grey=2.5, residual_percent_of_range=float("nan"), n_dofs=40,
        n_subdomains=2, n_ranks=1, krylov_iterations=[3, np.int64(2)], seconds={"solve": np.float64(0.5)},
        cpu_seconds={"solve": 0.4}, imbalance={"solve": 1.25}, peak_memory_bytes=(1000,), largest_jump_px=1e-9,
        linear_error_px=1e-6, n_pixels=1200, n_pixels_outside=3, grey_correction="none", result_file="r.vtkhdf")


def test_summary_is_plain_json_beside_the_result(tmp_path: Path) -> None:
    path = summary_path(tmp_path / "r.vtkhdf")
    assert path.name == "r.json"
    write_summary(path, summary())
    read = json.loads(path.read_text(), parse_constant=pytest.fail)
    assert (read["converged"], read["iterations"], read["krylov_iterations"]) == (True, 2, [3, 2])
    assert (read["seconds"], read["peak_memory_bytes"]) == ({"solve": 0.5}, [1000])
    assert read["imbalance"] == {"solve": 1.25}
    # JSON has no NaN.
    assert read["residual_percent_of_range"] is None
    assert [p.name for p in tmp_path.iterdir()] == ["r.json"]


def test_summary_in_a_folder_that_does_not_exist_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere"):
        write_summary(tmp_path / "nowhere" / "r.json", summary())


def test_summary_holds_ranges_and_tables(tmp_path: Path) -> None:
    ranges = FieldRanges({"x": (-1.0, 2.0)}, {"xx": (0.0, float("nan"))})
    told = dataclasses.replace(summary(), ranges=ranges, iteration_table={"iteration": [1, np.int64(2)]},
                               case={"path": "c.toml"}, images={"reference": "f.tif"})
    write_summary(tmp_path / "r.json", told)
    read = json.loads((tmp_path / "r.json").read_text(), parse_constant=pytest.fail)
    assert read["ranges"] == {"displacement_px": {"x": [-1.0, 2.0]}, "strain": {"xx": [0.0, None]}}
    assert read["iteration_table"] == {"iteration": [1, 2]}
    assert (read["case"], read["images"]) == ({"path": "c.toml"}, {"reference": "f.tif"})

"""Ranks and subdomains."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import pytest

from ddic.case.loader import load_case
from ddic.errors import InputError
from ddic.problem.check_inputs import check_ranks
from support.cases import write_case


@pytest.mark.parametrize(("solver", "n_ranks", "fits"), [
    ("subdomains = 4", 4, True), ("subdomains = 4", 5, False), ("", 99, True),
    ('partition = "blocks"\nblocks = [2, 3]', 6, True), ('partition = "blocks"\nblocks = [2, 3]', 7, False),
    ('method = "monolithic"', 1, True), ('method = "monolithic"', 2, False),
])
def test_more_ranks_than_subdomains_are_refused(tmp_path: Path, solver: str, n_ranks: int, fits: bool) -> None:
    loaded = load_case(write_case(tmp_path, f"[solver]\n{solver}\n"))
    with nullcontext() if fits else pytest.raises(InputError, match=f"case.toml: .*{n_ranks}"):
        check_ranks(loaded, n_ranks)

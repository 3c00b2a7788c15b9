"""Nodes that neither pixels nor mechanics hold have no value."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ddic.visibility.exclusions import KEPT
from support.measuring import whole_field
from support.spoilt import MESH, hide, measure_files

MANY = (60, 60, 170, 130)
"""Box of hidden pixels."""


def test_unmeasured_nodes_are_those_without_a_cell_that_counts(tmp_path: Path) -> None:
    measured, _ = measure_files(tmp_path, hide(MANY), '[solver]\npartition = "blocks"\nblocks = [4, 4]\n')
    whole = np.zeros(MESH.n_nodes, dtype=int)
    states = np.zeros(MESH.n_cells, dtype=int)
    for subdomain, is_unmeasured, (of_cells,) in zip(measured.subdomains, measured.unmeasured, measured.excluded.cells,
                                                     strict=True):
        whole[subdomain.node_ids] += is_unmeasured
        states[subdomain.cell_ids] = of_cells
    kept = np.unique(MESH.connectivity.reshape(-1, 4)[states == KEPT])
    expected = ~np.isin(np.arange(MESH.n_nodes), kept)
    # All copies of a node say the same.
    multiplicity = np.zeros(MESH.n_nodes, dtype=int)
    for subdomain in measured.subdomains:
        multiplicity[subdomain.node_ids] += 1
    np.testing.assert_array_equal(whole, multiplicity * expected)
    assert expected.sum() >= 16
    field = whole_field(measured)
    np.testing.assert_array_equal(np.isnan(field).all(axis=1), expected)


def test_mechanics_leave_no_node_unmeasured(tmp_path: Path) -> None:
    measured, _ = measure_files(tmp_path, hide(MANY), "[regularization]\ncut_off_wavelength = 100.0\n")
    assert not any(is_unmeasured.any() for is_unmeasured in measured.unmeasured)
    assert measured.excluded.is_any(measured.team)

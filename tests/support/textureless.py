"""Local systems of which a part sees no texture."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.solvers.local_system import LocalSystem
from support.linear import Decomposed


def without_texture(cut: Decomposed, blank: Callable[[LocalSystem], NDArray[np.bool_]]) -> list[LocalSystem]:
    """Systems without the rows and columns of M_s at the blank dofs, (n_dofs,)."""
    systems = []
    for system in cut.systems:
        keep = sparse.diags((~blank(system)).astype(float))
        systems.append(dataclasses.replace(system, hessian=(keep @ system.hessian @ keep).tocsr()))
    return systems


def corner(system: LocalSystem) -> NDArray[np.bool_]:
    """Dofs of the nodes within 40 px of the last corner of 16 x 16 cells, on its uncontrolled edge too."""
    nodes = system.subdomain.mesh.nodes
    return np.repeat((nodes > 20 + 8 * 16 - 40).all(axis=1), 2)

"""Elastic laws whose parameters are sought, by regions of the mesh; and the stiffness that they make of it.

Whatever the law, its stiffness tensor has six numbers in the plane, and K is linear in them:

    K(p) = sum over materials and numbers m of C_m(p) K_m,    dK / dp_k = sum of dC_m / dp_k K_m,

so that the matrices K_m, of the cells of a material and the tensor of which only the number m is 1, are assembled once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from typing import Literal

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray
from ddic.functionals.regularization import Material, assemble_tensor_stiffness
from ddic.mesh.mesh import Mesh

VOIGT = ((0, 0), (1, 1), (0, 1))
"""Components xx, yy and xy of strain and stress."""

NUMBERS = tuple(combinations_with_replacement(range(3), 2))
"""The six numbers of a plane stiffness, by rows and columns of Voigt's matrix."""

STEP = 1e-5
"""Step, relative to 1, by which the stiffness of a law is differentiated: central differences are then off by 1e-10."""

LawName = Literal["isotropic", "orthotropic"]

PARAMETERS: Mapping[LawName, tuple[str, ...]] = {
    "isotropic": ("young", "poisson_ratio"),
    "orthotropic": ("young_1", "young_2", "poisson_ratio", "shear", "angle_degrees"),
}
"""Names of a law's parameters, in their order: moduli in MPa, or relative ones where no force is known; of an
orthotropic law E1, E2, nu12, G12 and where axis 1 points, from +x towards +y."""


@dataclass(frozen=True)
class ElasticLaw:
    """Linear elasticity in the plane.

    Attributes
    ----------
    name : {"isotropic", "orthotropic"}
        Which.
    plane : {"stress", "strain"}
        What is zero across the plane, for an isotropic law; an orthotropic one is in plane stress.
    """

    name: LawName = "isotropic"
    plane: Literal["stress", "strain"] = "stress"

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its parameters, in their order."""
        return PARAMETERS[self.name]

    def compute_stiffness(self, values: Array) -> Array:
        """Compute C of sigma = C epsilon by Voigt's components xx, yy and 2 xy, (3, 3)."""
        if self.name == "orthotropic":
            young_1, unit, nu, shear, angle = values
            material = Material(nu, "stress", young_1 / unit, shear / unit, np.deg2rad(angle))
        else:
            unit, nu = values
            material = Material(nu, self.plane)
        # That of Young's modulus 1, or E2 = 1.
        tensor = unit * material.stiffness
        return np.array([[tensor[*row, *column] for column in VOIGT] for row in VOIGT])

    def is_possible(self, values: Array) -> bool:
        """Tell whether there may be such a material: whether its elastic energy is positive."""
        with np.errstate(all="ignore"):
            stiffness = self.compute_stiffness(values)
        return bool(np.isfinite(stiffness).all() and np.linalg.eigvalsh(stiffness).min() > 0
                    and (self.name == "orthotropic" or -1.0 < values[1] < 0.5))


@dataclass(frozen=True, eq=False)
class LawOnCells:
    """A law on some cells, with the values from which its parameters are sought.

    Attributes
    ----------
    law : ElasticLaw
        Its law.
    cells : (n_cells,) array of bool
        Where it is.
    values : (n_parameters,) array
        All parameters of the law: those that are fixed, and where the others begin.
    is_sought : (n_parameters,) array of bool
        Whether each is sought.
    label : str
        What its parameters are told apart by, where there are several materials; empty for one.
    """

    law: ElasticLaw
    cells: BoolArray
    values: Array
    is_sought: BoolArray
    label: str = ""


@dataclass(frozen=True, eq=False)
class ElasticBody:
    """A mesh made of materials: its stiffness, and how that changes with the parameters that are sought.

    Attributes
    ----------
    mesh : Mesh
        Plane; lengths in pixels.
    materials : sequence of LawOnCells
        Each cell is of one of them.
    """

    mesh: Mesh
    materials: Sequence[LawOnCells]

    @cached_property
    def names(self) -> list[str]:
        """Names of the parameters that are sought, in their order."""
        return [f"{material.label}.{name}" if material.label else name for material in self.materials
                for name, is_sought in zip(material.law.parameters, material.is_sought, strict=True) if is_sought]

    @property
    def start(self) -> Array:
        """Values from which they are sought, (n_parameters,)."""
        return np.concatenate([material.values[material.is_sought] for material in self.materials])

    def is_possible(self, parameters: Array) -> bool:
        """Tell whether there may be such materials."""
        return all(material.law.is_possible(values)
                   for material, values in zip(self.materials, self._list_values(parameters), strict=True))

    def assemble_stiffness(self, parameters: Array) -> sparse.csr_matrix:
        """Assemble K, (n_dofs, n_dofs): forces by displacements, per unit of thickness."""
        return self._add_up([_take_numbers(material.law.compute_stiffness(values)) for material, values
                             in zip(self.materials, self._list_values(parameters), strict=True)])

    def differentiate_stiffness(self, parameters: Array) -> list[sparse.csr_matrix]:
        """Differentiate K by each parameter that is sought."""
        derivatives = []
        for place, (material, values) in enumerate(zip(self.materials, self._list_values(parameters), strict=True)):
            for k in np.flatnonzero(material.is_sought):
                step = STEP * max(abs(values[k]), STEP) * np.eye(len(values))[k]
                change = (material.law.compute_stiffness(values + step)
                          - material.law.compute_stiffness(values - step)) / (2.0 * step[k])
                numbers = [np.zeros(len(NUMBERS)) for _ in self.materials]
                numbers[place] = _take_numbers(change)
                derivatives.append(self._add_up(numbers))
        return derivatives

    def _list_values(self, parameters: Array) -> list[Array]:
        """All values of each material, sought ones among them."""
        found, first = [], 0
        for material in self.materials:
            values = material.values.copy()
            n_sought = int(material.is_sought.sum())
            values[material.is_sought] = parameters[first:first + n_sought]
            found.append(values)
            first += n_sought
        return found

    @cached_property
    def _matrices(self) -> list[list[sparse.csr_matrix]]:
        """K_m of each material."""
        return [[assemble_tensor_stiffness(self.mesh, _make_tensor(row, column), material.cells)
                 for row, column in NUMBERS] for material in self.materials]

    def _add_up(self, numbers: Sequence[Array]) -> sparse.csr_matrix:
        total = sparse.csr_matrix((self.mesh.n_dofs, self.mesh.n_dofs))
        for of_material, matrices in zip(numbers, self._matrices, strict=True):
            for number, matrix in zip(of_material, matrices, strict=True):
                if number != 0.0:
                    total = total + number * matrix
        return total.tocsr()


def _take_numbers(stiffness: Array) -> Array:
    """The six numbers of Voigt's matrix."""
    return np.array([stiffness[row, column] for row, column in NUMBERS])


def _make_tensor(row: int, column: int) -> Array:
    """s_ik = C_ikjl e_jl of a stiffness of which one of the six numbers is 1."""
    tensor = np.zeros((2, 2, 2, 2))
    for a, b in {(row, column), (column, row)}:
        for i, k in {VOIGT[a], VOIGT[a][::-1]}:
            for j, l in {VOIGT[b], VOIGT[b][::-1]}:
                # The strain 2 e_xy is the sum of two components.
                tensor[i, k, j, l] = 1.0
    return tensor

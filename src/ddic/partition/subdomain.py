"""A subdomain: its part of the mesh, its unknowns, and what it shares with its neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ddic.kinematics.kinematics import Kinematics
from ddic.mesh.mesh import Mesh

Weighting = Literal["consistent", "paper"]


@dataclass(frozen=True)
class Interface:
    """Interface unknowns of one kind (displacement jumps or reactions) seen from one subdomain.

    An unknown shared by m subdomains carries m - 1 rows, a chain over the subdomains in increasing order: row k is
    (copy k) - (copy k + 1), so that rows are non-redundant at cross points.

    An unknown's rows and copies are numbered one after the other, over the whole region, independently of the number
    of ranks: those of subdomain 0's chains first (a chain belongs to its lowest subdomain).

    Attributes
    ----------
    unknowns : (n,) array of int64
        The subdomain's unknowns on the interface, by their place in the subdomain.
    multiplicity : (n,) array of int64
        Number m of subdomains that share each.
    position : (n,) array of int64
        Place of this subdomain in each chain, 0 <= position < m.
    first_row : (n,) array of int64
        Number of each chain's first row; the others follow.
    first_copy : (n,) array of int64
        Number of each chain's first copy; the others follow.
    """

    unknowns: NDArray[np.int64]
    multiplicity: NDArray[np.int64]
    position: NDArray[np.int64]
    first_row: NDArray[np.int64]
    first_copy: NDArray[np.int64]


@dataclass(frozen=True)
class MotionUnknowns:
    """Unknowns of the motion of a near-field set-up between its two pictures (alpha of Eq. 20 of [BP17]).

    Attributes
    ----------
    numbers : (n,) array of int64
        In the whole problem, after all unknowns of the field.
    rows : (n,) array of int64
        In the interface problem, after all chains.
    n_subdomains : int
        How many subdomains share them.
    owned : bool
        Whether they belong to this subdomain.
    """

    numbers: NDArray[np.int64]
    rows: NDArray[np.int64]
    n_subdomains: int
    owned: bool


@dataclass(frozen=True)
class Subdomain:
    """One subdomain, self-contained: what a rank receives.

    Its unknowns are those of the field, then those of its camera's motion.

    Attributes
    ----------
    index : int
        Its number.
    mesh : Mesh
        Its cells, specimen's frame, pixels.
    node_ids : (n_nodes,) array of int64
        Numbers of its nodes in the whole mesh.
    cell_ids : (n_cells,) array of int64
        Numbers of its cells in the whole mesh.
    kinematics : Kinematics
        From the field's unknowns to the displacement of its nodes in the specimen's frame.
    controlled : (n_field,) array of bool
        Whether the equilibrium row of each unknown of the field is controlled (P of Eq. 11 of [BP17]).
    interior : (n_nodes,) array of bool
        Whether a node lies inside the whole mesh, where texture is weighed against mechanics.
    node_multiplicity : (n_nodes,) array of int64
        Number of subdomains that share each node.
    multiplicity : (n_field,) array of int64
        Number of subdomains that share each unknown of the field.
    jumps : Interface
        Rows of C_s (Lambda).
    reactions : Interface
        Rows of Cbar_s (LambdaBar).
    n_owned_rows : int
        Interface rows that belong to this subdomain: those of its chains, and some of motions.
    n_owned_copies : int
        Copies of the chains that belong to this subdomain.
    camera : int
        Number of the camera whose pixels it has, 0 the first.
    motion : MotionUnknowns, optional
        Unknowns of the motion of that camera's set-up; None where it does not move.
    """

    index: int
    mesh: Mesh
    node_ids: NDArray[np.int64]
    cell_ids: NDArray[np.int64]
    kinematics: Kinematics
    controlled: NDArray[np.bool_]
    interior: NDArray[np.bool_]
    node_multiplicity: NDArray[np.int64]
    multiplicity: NDArray[np.int64]
    jumps: Interface
    reactions: Interface
    n_owned_rows: int
    n_owned_copies: int
    camera: int = 0
    motion: MotionUnknowns | None = None

    @property
    def n_field(self) -> int:
        """Number of unknowns of the field."""
        return self.kinematics.n_unknowns

    @property
    def n_motion(self) -> int:
        """Number of unknowns of its camera's motion."""
        return 0 if self.motion is None else len(self.motion.numbers)

    @property
    def n_unknowns(self) -> int:
        """Number of all its unknowns."""
        return self.n_field + self.n_motion

    @property
    def numbers(self) -> NDArray[np.int64]:
        """Numbers of all its unknowns in the whole problem, (n_unknowns,)."""
        field = self.kinematics.numbers
        return field if self.motion is None else np.concatenate([field, self.motion.numbers])

    @property
    def all_multiplicity(self) -> NDArray[np.int64]:
        """Number of subdomains that share each of its unknowns, (n_unknowns,)."""
        if self.motion is None:
            return self.multiplicity
        of_motion = np.full(self.n_motion, self.motion.n_subdomains, dtype=np.int64)
        return np.concatenate([self.multiplicity, of_motion])

    @property
    def owned(self) -> NDArray[np.bool_]:
        """Whether each unknown belongs to this subdomain, the lowest of those that share it, (n_unknowns,)."""
        owned = np.ones(self.n_unknowns, dtype=bool)
        owned[self.jumps.unknowns[self.jumps.position > 0]] = False
        if self.motion is not None:
            owned[self.n_field:] = self.motion.owned
        return owned

    def displacement(self, unknowns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displace the mesh's nodes in the specimen's frame.

        Parameters
        ----------
        unknowns : (n_unknowns,) or (n_field,) array
            Unknowns of the field; those of a motion after them do not matter.

        Returns
        -------
        (mesh.n_dofs,) array
            Displacement of the nodes, node by node, pixels.
        """
        return self.kinematics.displacement(unknowns[:self.n_field])


def interface_weights(multiplicity: NDArray[np.int64], weighting: Weighting) -> NDArray[np.float64]:
    """Weigh the interface rows of Kbar_s and of Cbar_s^T.

    Parameters
    ----------
    multiplicity : (n_field,) array of int64
        Number of subdomains that share each unknown.
    weighting : Weighting
        "consistent": sqrt(m), which makes the decomposed solution the one-domain solution. "paper": 1, which makes it
        that of the one-domain problem with interface rows weighted 1/sqrt(m).

    Returns
    -------
    (n_field,) array
        w, no unit.
    """
    if weighting == "paper":
        return np.ones(len(multiplicity))
    return np.sqrt(multiplicity.astype(np.float64))

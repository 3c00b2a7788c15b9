"""The images of a frame as evidence: M and b of all subdomains, gathered to rank 0 in the order of the subdomains.

The model knows linear elasticity, hence rotations of small angles only: where the region has turned by more, it is the
displacement u' before that rotation which obeys the model, u = R (x + u') - x, and M and b are turned back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from ddic.arrays import Array, IntArray
from ddic.functionals.correlation import refine_correlation
from ddic.functionals.view import FrameView
from ddic.kinematics.nodal import NodalKinematics, component_numbers
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import build_tree
from ddic.mesh.refinement import RefinedMesh, refine
from ddic.mesh.rotation import Rotation
from ddic.parallel.field import Field
from ddic.parallel.team import Team, require_held
from ddic.problem.added_forces import LEAST_ANGLE, fit_rigid_motion
from ddic.problem.reference_problem import add_matrices
from ddic.problem.residual_model import ResidualModel


@dataclass(frozen=True, eq=False)
class ImageEvidence:
    """What the images of a frame say of a displacement of the whole mesh; a ``FrameEvidence``.

    Attributes
    ----------
    model : ResidualModel
        Of the frame, with the pixels that count, of one camera.
    numbers : sequence of (n_dofs,) array of int64
        Of each owned subdomain's displacements of nodes among those of the whole mesh.
    nodes : (n_nodes, dim) array or None
        Of the whole mesh, on rank 0, pixels; None elsewhere.
    measured : Field
        What was measured, pixels.
    rotation : Rotation
        R.
    """

    model: ResidualModel
    numbers: Sequence[IntArray]
    nodes: Array | None
    measured: Field
    rotation: Rotation

    @classmethod
    def of_frame(cls, model: ResidualModel, measured: Field, mesh: Mesh | None, *,
                 turned_back: bool = True) -> ImageEvidence:
        """Take a frame that was measured; collective, ``mesh`` is the whole one on rank 0.

        ``turned_back`` says whether the model knows rotations of small angles only.
        """
        rotation = fit_rigid_motion(measured).rotation
        if abs(rotation.angle) <= LEAST_ANGLE or not turned_back:
            rotation = Rotation.none(model.subdomains[0].mesh.dim)
        # Operators of regularization have no part in it.
        images_alone = replace(model, rotation=None, filled=None, pulled=None, known=None)
        numbers = [subdomain.kinematics.numbers for subdomain in model.subdomains]
        return cls(images_alone, numbers, None if mesh is None else mesh.nodes, measured, rotation)

    @property
    def _team(self) -> Team:
        return self.model.team

    def gather_hessian(self) -> sparse.csr_matrix | None:
        """Give M, turned back, on rank 0; collective where it is asked for first."""
        return self._hessian

    @cached_property
    def _hessian(self) -> sparse.csr_matrix | None:
        model = self.model
        shown = self._team.together(lambda: model.views.map(model.show, model.views.fill(self.measured)))
        hessians = self._team.together(lambda: add_matrices(
            shown.map(lambda view: view.project(view.assemble_hessian()))))
        parts = self._team.gather_to([(subdomain.index, of_nodes, hessian.tocoo()) for subdomain, of_nodes, hessian
                                      in zip(model.subdomains, self.numbers, hessians, strict=True)])
        if parts is None:
            return None
        n_dofs = require_held(self.nodes).size
        total = sparse.csr_matrix((n_dofs, n_dofs))
        for _, of_nodes, hessian in sorted((part for of_rank in parts for part in of_rank), key=lambda part: part[0]):
            total = total + sparse.csr_matrix((hessian.data, (of_nodes[hessian.row], of_nodes[hessian.col])),
                                              (n_dofs, n_dofs))
        if self.rotation.angle == 0:
            return total.tocsr()
        turn = sparse.kron(sparse.identity(n_dofs // len(self.rotation.matrix)), self.rotation.matrix).tocsr()
        return (turn.T @ total @ turn).tocsr()

    def gather_forces(self, u: Array | None) -> Array | None:
        """Give b at a displacement of the whole mesh, turned back, on rank 0; collective."""
        moved = None if u is None else self.apply_rotation(u)
        whole: Array = self._team.broadcast(moved)
        q = self.measured.with_parts(whole[numbers] for numbers in self.numbers)
        b = self.model.assemble_right_hand_side(self.model.evaluate(q), q)
        parts = self._team.gather_to([(subdomain.index, numbers, of_subdomain) for subdomain, numbers, of_subdomain
                                      in zip(self.model.subdomains, self.numbers, b, strict=True)])
        if parts is None:
            return None
        total = np.zeros(len(whole))
        for _, numbers, of_subdomain in sorted((part for of_rank in parts for part in of_rank),
                                               key=lambda part: part[0]):
            total[numbers] += of_subdomain
        return self.rotation.apply_inverse(total.reshape(require_held(self.nodes).shape)).ravel()

    def gather_measured(self) -> Array | None:
        """Give the displacement that was measured, turned back, on rank 0; collective."""
        parts = self._team.gather_to(list(zip(self.numbers, self.measured, strict=True)))
        if parts is None:
            return None
        nodes = require_held(self.nodes)
        u = np.zeros(nodes.size)
        for of_rank in parts:
            for numbers, of_subdomain in of_rank:
                u[numbers] = of_subdomain
        return (self.rotation.apply_inverse(nodes + u.reshape(nodes.shape)) - nodes).ravel()

    def refine(self, refined: RefinedMesh | None) -> ImageEvidence:
        """Take the same pixels on a mesh of half the size; collective, ``refined`` is the whole one on rank 0."""
        nodes: Array = self._team.broadcast(None if refined is None else refined.mesh.nodes)
        parts = [refine(subdomain.mesh) for subdomain in self.model.subdomains]
        # New nodes have no numbers but by their places.
        tree = build_tree(nodes)
        numbers = [component_numbers(tree.query(part.mesh.nodes)[1], nodes.shape[1]) for part in parts]

        def refine_view(view: FrameView, part: RefinedMesh, of_nodes: IntArray) -> FrameView:
            correlation = refine_correlation(view.correlation, part)
            return replace(view, correlation=correlation, prepared=correlation,
                           kinematics=NodalKinematics(part.mesh, of_nodes))

        views = self.model.views
        fine = self._team.together(lambda: views.map(refine_view, views.fill(parts), views.fill(numbers)))
        measured = self.measured.with_parts(part.interpolate(q) for part, q in zip(parts, self.measured, strict=True))
        return replace(self, model=replace(self.model, views=fine), numbers=numbers,
                       nodes=None if refined is None else nodes, measured=measured)

    def apply_rotation(self, u: Array) -> Array:
        """Turn a displacement that obeys the model, (n_dofs,), on rank 0, by the region's rotation: u of u'."""
        nodes = require_held(self.nodes)
        return (self.rotation.apply(nodes + u.reshape(nodes.shape)) - nodes).ravel()

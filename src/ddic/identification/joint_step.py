"""One step of Gauss-Newton for parameters and displacements together.

In each frame the displacement u obeys equilibrium on all nodes but those of loaded edges, K_I(p) u = 0, and its values
on these edges are as unknown as the parameters p: u = G u_B with T = [G, S], S_k = -K_II^-1 (dK / dp_k u)_I the
sensitivities. Neither G nor S is formed. With M' = M / (2 sigma^2), b' = b / (2 sigma^2) and the difference dF between
forces that were measured to sigma_F and those of K u, of which phi_u and phi_p are the derivatives, the correction
minimises

    1/2 du^T M' du - b'^T du + 1/2 |y|^2,   y = (phi_u^T du + phi_p^T dp - dF) / sigma_F,
    subject to K_I du + (dK / dp u)_I dp = -K_I u,

whose multipliers are lambda:

    [ M'              phi_u / sigma_F   K_I^T ] [ du     ]   [ b'                          ]
    [ phi_u^T/sigma_F      -1             0   ] [ y      ] = [ (dF - phi_p^T dp) / sigma_F ]   =   r - C dp.
    [ K_I                   0             0   ] [ lambda ]   [ -K_I u - (dK / dp u)_I dp   ]

With A the matrix, stationarity in p is sum over frames of C^T A^-1 (r - C dp) = 0. What multiplies dp, with the sign
turned, is H with the boundary displacements eliminated; its inverse is the covariance of p.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import InputError
from ddic.identification.laws import ElasticBody


@dataclass(frozen=True, eq=False)
class MeasuredForce:
    """The resultant of what acts on some nodes, measured in every frame.

    Attributes
    ----------
    nodes : (n,) array of int64
        Of the whole mesh.
    direction : (dim,) array
        Unit vector along which it is measured, in the image.
    values : (n_frames,) array
        Of each frame, N.
    deviation : float
        Its standard deviation, N.
    factor : float
        Thickness times the size of a pixel, square millimetres per pixel: what turns K u, moduli in MPa and
        displacements in pixels, into a force in N.
    """

    nodes: IntArray
    direction: Array
    values: Array
    deviation: float
    factor: float

    def differentiate(self, stiffness: sparse.csr_matrix) -> Array:
        """Differentiate the force of K u by u, (n_dofs,), N per pixel."""
        dim = len(self.direction)
        weights = np.zeros(stiffness.shape[0])
        for axis, share in enumerate(self.direction):
            weights[dim * self.nodes + axis] = self.factor * share
        return np.asarray(stiffness.T @ weights)


@dataclass(frozen=True, eq=False)
class FrameTerms:
    """What a frame says at a displacement.

    Attributes
    ----------
    u : (n_dofs,) array
        Displacement of all nodes, pixels.
    hessian : (n_dofs, n_dofs) csr_matrix
        M', 1 / px^2.
    b : (n_dofs,) array
        b', 1 / px.
    """

    u: Array
    hessian: sparse.csr_matrix
    b: Array


@dataclass(frozen=True, eq=False)
class JointStep:
    """A correction, and what the frames tell of the parameters.

    Attributes
    ----------
    dp : (n_parameters,) array
        Of the parameters.
    du : list of (n_dofs,) array
        Of the displacement in each frame, pixels.
    information : (n_parameters, n_parameters) array
        H, the inverse of their covariance.
    """

    dp: Array
    du: list[Array]
    information: Array


class MaterialModel(Protocol):
    """What displacements a specimen may have, by parameters: the seam that a law of one's own implements."""

    @property
    def names(self) -> Sequence[str]:
        """Names of the parameters that are sought."""

    @property
    def start(self) -> Array:
        """Values from which they are sought, (n_parameters,)."""

    def is_possible(self, parameters: Array) -> bool:
        """Tell whether there may be such a specimen."""

    def solve_step(self, parameters: Array, frames: Sequence[FrameTerms]) -> JointStep:
        """Solve for a correction of parameters and displacements together.

        Parameters
        ----------
        parameters : (n_parameters,) array
            Where they are.
        frames : sequence of FrameTerms
            What each frame says there.

        Returns
        -------
        JointStep
            By which parameters and displacements go on, to first order in agreement with the model.
        """


@dataclass(frozen=True, eq=False)
class ElasticModel:
    """An elastic body in equilibrium, whose loaded edges move by whatever the images show; a ``MaterialModel``.

    Attributes
    ----------
    body : ElasticBody
        Mesh and laws.
    in_equilibrium : (n_nodes,) array of bool
        Nodes on which nothing acts.
    forces : sequence of MeasuredForce
        What is known of the forces on others.
    """

    body: ElasticBody
    in_equilibrium: BoolArray
    forces: Sequence[MeasuredForce] = ()

    @property
    def names(self) -> Sequence[str]:
        """Names of the parameters that are sought."""
        return self.body.names

    @property
    def start(self) -> Array:
        """Values from which they are sought."""
        return self.body.start

    def is_possible(self, parameters: Array) -> bool:
        """Tell whether there may be such a material."""
        return self.body.is_possible(parameters)

    def solve_step(self, parameters: Array, frames: Sequence[FrameTerms]) -> JointStep:
        """Solve the saddle point of every frame, and the parameters' equation over all of them.

        Raises InputError where the frames do not tell the parameters apart.
        """
        stiffness, slopes = self.body.assemble_stiffness(parameters), self.body.differentiate_stiffness(parameters)
        rows = np.flatnonzero(np.repeat(self.in_equilibrium, self.body.mesh.dim))
        # So that rows of equilibrium weigh about as much as those of M'.
        scale = float(np.mean(frames[0].hessian.diagonal()) / np.mean(stiffness.diagonal()))
        of_u = [force.differentiate(stiffness) for force in self.forces]
        of_p = [[force.differentiate(slope) for slope in slopes] for force in self.forces]
        n_parameters, solve = len(parameters), None
        information, gradient = np.zeros((n_parameters, n_parameters)), np.zeros(n_parameters)
        solved = []
        for number, frame in enumerate(frames):
            if solve is None or frame.hessian is not frames[number - 1].hessian:
                solve = self._factorize(frame.hessian, scale * stiffness[rows], of_u)
            differences = [(force.values[number] - slope @ frame.u) / force.deviation
                           for force, slope in zip(self.forces, of_u, strict=True)]
            right = np.concatenate([frame.b, differences, -scale * (stiffness @ frame.u)[rows]])
            columns = [np.concatenate([np.zeros(len(frame.u)),
                                       [by_p[k] @ frame.u / force.deviation
                                        for force, by_p in zip(self.forces, of_p, strict=True)],
                                       scale * (slope @ frame.u)[rows]]) for k, slope in enumerate(slopes)]
            coupling = np.array(columns).T
            at_rest, answers = solve(right), solve(coupling)
            information -= coupling.T @ answers
            gradient -= coupling.T @ at_rest
            solved.append((at_rest[:len(frame.u)], answers[:len(frame.u)]))
        information = 0.5 * (information + information.T)
        dp = _solve_for_parameters(information, gradient, self.names)
        return JointStep(dp, [at_rest - answers @ dp for at_rest, answers in solved], information)

    def _factorize(self, hessian: sparse.csr_matrix, equilibrium: sparse.csr_matrix,
                   of_u: Sequence[Array]) -> Callable[[Array], Array]:
        """Factorise A of a frame."""
        n_rows = equilibrium.shape[0]
        blocks = [[hessian, equilibrium.T], [equilibrium, sparse.csr_matrix((n_rows, n_rows))]]
        if self.forces:
            slopes = sparse.csr_matrix(np.array([slope / force.deviation
                                                 for force, slope in zip(self.forces, of_u, strict=True)]))
            blocks = [[hessian, slopes.T, equilibrium.T],
                      [slopes, -sparse.identity(len(self.forces)), None],
                      [equilibrium, None, blocks[1][1]]]
        factor = linalg.splu(sparse.bmat(blocks).tocsc())
        solve: Callable[[Array], Array] = factor.solve
        return solve


LEAST_MOVED = 1e-12
"""Of the largest displacement, what a step of a parameter moves by rounding alone."""

LEAST_INFORMATION = 1e-12
"""Eigenvalue of the information on parameters, each in units of its own deviation, up to which two of them cannot be
told apart."""


def _solve_for_parameters(information: Array, gradient: Array, names: Sequence[str]) -> Array:
    """Solve H dp = g; raises InputError where H is singular."""
    scales = np.sqrt(np.maximum(information.diagonal(), 1e-300))
    scaled = information / np.outer(scales, scales)
    values, vectors = np.linalg.eigh(scaled)
    if values[0] <= LEAST_INFORMATION:
        worst = [names[k] for k in np.argsort(-abs(vectors[:, 0]))[:2]]
        raise InputError(f"identification: the images and forces do not tell {' and '.join(worst)}; fix one of them, "
                         "or give a force")
    return np.asarray(np.linalg.solve(scaled, gradient / scales) / scales)


@dataclass(frozen=True, eq=False)
class FunctionModel:
    """A function of one's own that gives the displacement of the nodes in every frame; a ``MaterialModel``.

    Attributes
    ----------
    names : sequence of str
        Of its parameters, amplitudes of loaded edges among them.
    start : (n_parameters,) array
        Values from which they are sought.
    simulate : callable
        From parameters, (n_parameters,), to the displacement of all nodes in every frame, (n_frames, n_nodes, dim),
        pixels, and its derivatives by each parameter, (n_parameters, n_frames, n_nodes, dim), or None for these to be
        found by differences.
    steps : (n_parameters,) array
        Steps of these differences.
    """

    names: Sequence[str]
    start: Array
    simulate: Callable[[Array], tuple[Array, Array | None]]
    steps: Array

    def is_possible(self, parameters: Array) -> bool:
        """Tell whether parameters are numbers; the function knows more."""
        return bool(np.isfinite(parameters).all())

    def solve_step(self, parameters: Array, frames: Sequence[FrameTerms]) -> JointStep:
        """Solve H dp = sum of S^T (b' + M' (u - u(p))), H = sum of S^T M' S over the frames."""
        displacement, slopes = self.simulate(parameters)
        if slopes is None:
            slopes = np.stack([(self.simulate(parameters + step)[0] - self.simulate(parameters - step)[0])
                               / (2.0 * step.sum()) for step in np.diag(self.steps)])
        moved = np.abs(slopes).reshape(len(parameters), -1).max(axis=1) * self.steps
        for name in np.array(self.names)[moved <= LEAST_MOVED * np.abs(displacement).max()]:
            raise InputError(f"identification: {name} moves no node; leave it out, or look at its step")
        information, gradient = np.zeros((len(parameters),) * 2), np.zeros(len(parameters))
        offsets, of_frames = [], []
        for number, frame in enumerate(frames):
            s = np.asarray(slopes)[:, number].reshape(len(parameters), -1)
            offsets.append(np.asarray(displacement)[number].ravel() - frame.u)
            of_frames.append(s)
            information += s @ (frame.hessian @ s.T)
            gradient += s @ (frame.b - frame.hessian @ offsets[-1])
        dp = _solve_for_parameters(information, gradient, self.names)
        return JointStep(dp, [offset + dp @ s for offset, s in zip(offsets, of_frames, strict=True)], information)

"""Equilibrium gap: Kbar = P K and its weight eta from a cut-off wavelength [LPHR11]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.functionals.elasticity import Material, assemble_stiffness, integrate_cell_stiffness
from ddic.functionals.scale_rows import scale_rows
from ddic.kinematics.cell_interpolation import number_cell_dofs
from ddic.kinematics.kinematics import Kinematics
from ddic.mesh.mesh import Mesh

PHASES = (0.0, np.pi / 2)
"""Phases of the plane waves, radians: cosine and sine, of which one at least does not vanish on the nodes."""

_GAP_CHUNK_CELLS = 16_000
"""Cells whose stiffness is held at once; a larger value takes more memory, a smaller one time."""


def controlled_stiffness(kinematics: Kinematics, material: Material, row_weights: NDArray[np.float64],
                         rotation: NDArray[np.float64] | None = None) -> sparse.csr_matrix:
    """Assemble Kbar = diag(row_weights) T^T K T, weight 0 dropping a row (P of Eq. 11 of [BP17]).

    K acts on the nodes; T^T K T are the forces on the unknowns: those on tied nodes are then their masters', as much as
    these move them.

    Parameters
    ----------
    kinematics : Kinematics
        From unknowns to the displacement of the mesh's nodes, specimen's frame.
    material : Material
        The same in all cells.
    row_weights : (n_unknowns,) array
        Weights of the rows.
    rotation : (dim, dim) array, optional
        R by which the specimen has turned: the stiffness is then R K R^T. None, by default, for the identity.

    Returns
    -------
    (n_unknowns, n_unknowns) csr_matrix
        Kbar.
    """
    of_nodes = assemble_stiffness(kinematics.mesh, material)
    if rotation is not None:
        turn = sparse.kron(sparse.identity(kinematics.mesh.n_nodes), rotation, format="csr")
        of_nodes = (turn @ of_nodes @ turn.T).tocsr()
    stiffness = kinematics.project_matrix(of_nodes)
    return scale_rows(stiffness, row_weights)


def evaluate_plane_waves(nodes: NDArray[np.float64], wavelength: float) -> NDArray[np.float64]:
    """Evaluate the waves v = e_a cos(2 pi x_b / l_c + phi) for all axes a, b and phi in {0, pi/2}.

    Parameters
    ----------
    nodes : (n, dim) array
        Pixels.
    wavelength : float
        l_c, pixels.

    Returns
    -------
    (n dim, 2 dim^2) array
        One wave a column, node-major; the phase varies fastest, then b.
    """
    n, dim = nodes.shape
    waves = []
    for a in range(dim):
        for b in range(dim):
            for phi in PHASES:
                v = np.zeros((n, dim))
                v[:, a] = np.cos(2 * np.pi * nodes[:, b] / wavelength + phi)
                waves.append(v.ravel())
    return np.stack(waves, axis=1)


def measure_gap_energies(mesh: Mesh, material: Material, interior_nodes: NDArray[np.bool_],
                 wavelength: float) -> NDArray[np.float64]:
    """Measure |K v|^2 of every plane wave on the interior nodes' rows, K never assembled.

    Parameters
    ----------
    mesh : Mesh
        The whole region's.
    material : Material
        The same in all cells.
    interior_nodes : (n_nodes,) bool array
        Nodes whose rows count.
    wavelength : float
        l_c, pixels.

    Returns
    -------
    (n_waves,) array
        Square pixels, one for each column of ``evaluate_plane_waves``.
    """
    waves = evaluate_plane_waves(mesh.nodes, wavelength)
    forces = np.zeros_like(waves)
    for begin in range(0, mesh.n_cells, _GAP_CHUNK_CELLS):
        cells = np.arange(begin, min(begin + _GAP_CHUNK_CELLS, mesh.n_cells))
        part, node_ids = mesh.create_submesh(cells)
        dofs = (node_ids[:, None] * mesh.dim + np.arange(mesh.dim)).ravel()
        forces[dofs] += _wave_forces(part, material, waves[dofs])
    rows = np.repeat(interior_nodes, mesh.dim)
    return np.asarray((forces[rows] ** 2).sum(axis=0))


def measure_texture_energies(nodes: NDArray[np.float64], hessian: sparse.csr_matrix,
                     interior_nodes: NDArray[np.bool_], wavelength: float) -> NDArray[np.float64]:
    """Measure v^T M v of every plane wave on the interior nodes' rows; adds up over subdomains.

    Parameters
    ----------
    nodes : (n, dim) array
        Nodes whose displacements M is between, pixels.
    hessian : (n dim, n dim) csr_matrix
        M of a subdomain, node-major, grey levels squared per square pixel.
    interior_nodes : (n,) bool array
        Nodes whose rows count.
    wavelength : float
        l_c, pixels.

    Returns
    -------
    (n_waves,) array
        Grey levels squared, one for each column of ``evaluate_plane_waves``.
    """
    waves = evaluate_plane_waves(nodes, wavelength)
    rows = np.repeat(interior_nodes, nodes.shape[1])
    return np.asarray((waves * (hessian @ waves))[rows].sum(axis=0))


def find_cut_off_weight(texture: NDArray[np.float64], gap: NDArray[np.float64]) -> float:
    """Choose the weight eta at which texture and mechanics count alike at l_c: mean of |v^T M v| / |K v|^2 [LPHR11].

    The two phases of a wave are added up before the ratio, for one may vanish on all nodes; the mean is over a and b.

    Parameters
    ----------
    texture, gap : (n_waves,) arrays
        ``measure_texture_energies`` and ``measure_gap_energies`` on the same nodes.

    Returns
    -------
    float
        eta, grey levels squared per square pixel.
    """
    n_phases = len(PHASES)
    texture_by_wave = np.abs(texture).reshape(-1, n_phases).sum(axis=1)
    gap_by_wave = gap.reshape(-1, n_phases).sum(axis=1)
    return float((texture_by_wave / gap_by_wave).mean())


def find_edge_weight(eta: float, probe: tuple[float, float], edge_wavelength: float) -> float:
    """Choose the weight of rows whose equilibrium is not imposed, relative to the others.

    eta grows as the fourth power of the wavelength, and the rows' weight enters as its square.

    Parameters
    ----------
    eta : float
        Weight of the equilibrium gap, grey levels squared per square pixel.
    probe : tuple of float
        A wavelength, pixels, and the eta that belongs to it.
    edge_wavelength : float
        Below which equilibrium rules these rows, pixels; 0 for never.

    Returns
    -------
    float
        From 0 to 1.
    """
    wavelength, eta_there = probe
    eta_of_edges = eta_there * (edge_wavelength / wavelength) ** 4
    return min(1.0, float(np.sqrt(eta_of_edges / eta)))


def _wave_forces(mesh: Mesh, material: Material, waves: NDArray[np.float64]) -> NDArray[np.float64]:
    """K v, (n_dofs, n_waves), of displacements v, the columns of waves."""
    cell_dofs = number_cell_dofs(mesh)
    by_cell = integrate_cell_stiffness(mesh, material) @ waves[cell_dofs]
    columns = [np.bincount(cell_dofs.ravel(), by_cell[..., wave].ravel(), minlength=mesh.n_dofs)
               for wave in range(waves.shape[1])]
    return np.stack(columns, axis=1)

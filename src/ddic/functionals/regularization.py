"""Equilibrium gap: Kbar = P K and its weight eta from a cut-off wavelength [LPHR11].

K is the linear elastic stiffness with Young's modulus 1 (of a composite E2), unit thickness, lengths in pixels.
"""

from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray
from ddic.kinematics.cell_interpolation import interpolate_cells, number_cell_dofs
from ddic.kinematics.kinematics import Kinematics
from ddic.mesh.cell_parts import CellParts, place_quadrature_points
from ddic.mesh.interpolation import differentiate_shapes_at
from ddic.mesh.mesh import Mesh, compute_shape_gradients
from ddic.mesh.rotation import build_rotation

_CHUNK_CELLS = 2_000
"""Cells whose products of gradients are held at once: few enough for a processor's cache, in which they take half the
time. A larger value takes more memory, too."""


@dataclass(frozen=True)
class Material:
    """Elasticity, isotropic with E = 1, or orthotropic with E2 = 1 and its axes 1 and 2 in the plane.

    Attributes
    ----------
    poisson_ratio : float
        nu, -1 < nu < 0.5; of an orthotropic material nu12, nu12^2 < E1 / E2.
    plane : {"stress", "strain"} or None
        Whether the stress or the strain across the plane is zero; it is the stress in an orthotropic material. None in
        a volume, where the material is isotropic.
    young_ratio : float
        E1 / E2.
    shear_ratio : float or None
        G12 / E2; None for 1 / (2 (1 + poisson_ratio)).
    angle : float
        Of axis 1, radians from +x to +y.
    """

    poisson_ratio: float = 0.3
    plane: Literal["stress", "strain"] | None = "stress"
    young_ratio: float = 1.0
    shear_ratio: float | None = None
    angle: float = 0.0

    @classmethod
    def default(cls, dim: int) -> Self:
        """Give the isotropic one with the default ratio of Poisson, in plane stress or in space."""
        return cls(plane="stress" if dim == 2 else None)

    @property
    def is_isotropic(self) -> bool:
        """Whether it has no axes."""
        return self.young_ratio == 1.0 and self.shear_ratio is None

    @property
    def axes(self) -> Array:
        """Unit vectors along its axes, one a column, (dim, dim)."""
        return np.eye(3) if self.plane is None else build_rotation(self.angle)

    @property
    def lame(self) -> tuple[float, float]:
        """Lambda and mu of s = lambda tr(e) I + 2 mu e: lambda of plane stress, or of plane strain and of space."""
        nu = self.poisson_ratio
        lame = nu / (1.0 - nu**2) if self.plane == "stress" else nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
        return lame, 1.0 / (2.0 * (1.0 + nu))

    @property
    def moduli(self) -> tuple[float, float, float, float]:
        """C11, C22, C12 and G12 of s_11 = C11 e_11 + C12 e_22, s_22 = C12 e_11 + C22 e_22, s_12 = 2 G12 e_12."""
        lame, mu = self.lame
        if self.is_isotropic:
            return lame + 2.0 * mu, lame + 2.0 * mu, lame, mu
        # The inverse of e_11 = (s_11 - nu12 s_22) / E1, e_22 = s_22 / E2 - nu12 s_11 / E1.
        c22 = 1.0 / (1.0 - self.poisson_ratio**2 / self.young_ratio)
        shear = mu if self.shear_ratio is None else self.shear_ratio
        return self.young_ratio * c22, c22, self.poisson_ratio * c22, shear

    @property
    def stiffness(self) -> Array:
        """C of s_ik = C_ikjl e_jl, along x and y, (2, 2, 2, 2)."""
        c11, c22, c12, shear = self.moduli
        along_axes = np.zeros((2, 2, 2, 2))
        along_axes[0, 0, 0, 0], along_axes[1, 1, 1, 1] = c11, c22
        along_axes[0, 0, 1, 1] = along_axes[1, 1, 0, 0] = c12
        for i, k in ((0, 1), (1, 0)):
            along_axes[i, k, i, k] = along_axes[i, k, k, i] = shear
        return np.asarray(np.einsum("ip,kq,jr,ls,pqrs->ikjl", *[self.axes] * 4, along_axes))


def integrate_cell_stiffness(mesh: Mesh, material: Material) -> Array:
    """Integrate K_e = int eps(v) : C : eps(u), C eps = lambda tr(eps) I + 2 mu eps if isotropic, over cells or parts.

    K_e is between displacement components, (n_cells, n_monomials dim, n_monomials dim), node-major; zero for nodes that
    a cell does not have. Lengths are in pixels.
    """
    width = mesh.n_monomials * mesh.dim
    cells = np.zeros((mesh.n_cells, width, width))
    for block in mesh.cell_blocks:
        quadrature = block.type.quadrature
        n = block.type.n_nodes * mesh.dim
        weighing = _weigh_all_products(block.type.n_nodes, mesh.dim, material)
        for begin in range(0, len(block.cells), _CHUNK_CELLS):
            chunk = replace(block, cells=block.cells[begin:begin + _CHUNK_CELLS],
                            nodes=block.nodes[begin:begin + _CHUNK_CELLS])
            gradients, det = compute_shape_gradients(mesh, chunk, quadrature.points)
            products = _integrate_products(gradients, det * quadrature.weights)
            cells[chunk.cells, :n, :n] = (products.reshape(-1, n * n) @ weighing).reshape(-1, n, n)
    if mesh.parts is not None and mesh.parts.n_parts:
        cells[mesh.parts.cells] = _integrate_parts(mesh, mesh.parts, material)
    return cells


def _integrate_parts(mesh: Mesh, parts: CellParts, material: Material) -> Array:
    """K_e of the cells that are parts, over their outlines: (n_parts, 4 dim, 4 dim)."""
    points, weights, numbers = place_quadrature_points(parts)
    gradients = differentiate_shapes_at(mesh, parts.cells[numbers], points)
    rows = gradients.reshape(len(points), -1)
    at_points = rows[:, :, None] * (weights[:, None] * rows)[:, None, :]
    ends = np.searchsorted(numbers, np.arange(len(parts.cells)))
    products = np.add.reduceat(at_points, ends, axis=0)
    k, dim = gradients.shape[1:]
    of_parts = _weigh_products(products.reshape(-1, k, dim, k, dim), material)
    return of_parts.reshape(len(parts.cells), k * dim, k * dim)


def _weigh_products(products: Array, material: Material) -> Array:
    """K_e from the integrals of dN_a/dx_i dN_b/dx_j, both (n_cells, a, i, b, j)."""
    if not material.is_isotropic:
        return np.asarray(np.einsum("ikjl,eakbl->eaibj", material.stiffness, products))
    lame, shear = material.lame
    # 2 mu eps(u) : eps(v) = mu (grad u : grad v + grad u : grad v^T)
    stiffness = lame * products + shear * products.swapaxes(2, 4)
    laplacian = shear * np.trace(products, axis1=2, axis2=4)
    for i in range(products.shape[2]):
        stiffness[:, :, i, :, i] += laplacian
    return stiffness


def _weigh_all_products(n_nodes: int, dim: int, material: Material) -> Array:
    """What each integral of dN_a/dx_i dN_b/dx_j adds to K_e: a matrix, which many cells are multiplied by at once."""
    n_products = (n_nodes * dim) ** 2
    one_by_one = np.eye(n_products).reshape(n_products, n_nodes, dim, n_nodes, dim)
    return _weigh_products(one_by_one, material).reshape(n_products, n_products)


def assemble_stiffness(mesh: Mesh, material: Material, relative: Array | None = None) -> sparse.csr_matrix:
    """Assemble K of a mesh, which acts on displacements of its nodes: the K of Eq. 9 of [BP17].

    (n_dofs, n_dofs), symmetric; its null space is the rigid motions. Lengths are in pixels. ``relative``, (n_cells,),
    are factors of the cells' stiffness, 1 where left out.
    """
    of_cells = integrate_cell_stiffness(mesh, material)
    if relative is not None:
        of_cells *= relative[:, None, None]
    return interpolate_cells(mesh).assemble_matrix(of_cells)


def assemble_tensor_stiffness(mesh: Mesh, tensor: Array, cells: BoolArray) -> sparse.csr_matrix:
    """Assemble the stiffness of some cells, (n_cells,), with s_ik = C_ikjl e_jl, (dim, dim, dim, dim), on (n_dofs,)."""
    width = mesh.n_monomials * mesh.dim
    of_cells = np.zeros((mesh.n_cells, width, width))
    for block in mesh.cell_blocks:
        quadrature, n = block.type.quadrature, block.type.n_nodes * mesh.dim
        chosen = replace(block, cells=block.cells[cells[block.cells]], nodes=block.nodes[cells[block.cells]])
        gradients, det = compute_shape_gradients(mesh, chosen, quadrature.points)
        products = _integrate_products(gradients, det * quadrature.weights)
        of_cells[chosen.cells, :n, :n] = np.einsum("ikjl,eakbl->eaibj", tensor, products).reshape(-1, n, n)
    return interpolate_cells(mesh).assemble_matrix(of_cells)


def _integrate_products(gradients: Array, weights: Array) -> Array:
    """Integrals of dN_a/dx_i dN_b/dx_j, (n_cells, a, i, b, j), from gradients and weights at points of the cells."""
    n_cells, n_points, k, dim = gradients.shape
    rows = gradients.reshape(n_cells, n_points, k * dim)
    products = rows.transpose(0, 2, 1) @ (rows * weights[..., None])
    return np.asarray(products.reshape(n_cells, k, dim, k, dim))


PHASES = (0.0, np.pi / 2)
"""Phases of the plane waves, radians: cosine and sine, of which one at least does not vanish on the nodes."""

_GAP_CHUNK_CELLS = 16_000
"""Cells whose stiffness is held at once; a larger value takes more memory, a smaller one time."""


def controlled_stiffness(kinematics: Kinematics, material: Material, row_weights: Array,
                         rotation: Array | None = None, relative: Array | None = None) -> sparse.csr_matrix:
    """Assemble diag(row_weights) T^T K T: Kbar = P K of Eq. 9 of [BP17], where P is among the weights.

    K acts on the nodes; T^T K T, (n_unknowns, n_unknowns), are the forces on the unknowns: those on tied nodes are then
    their masters', as much as these move them. ``rotation`` is R by which the specimen has turned: the stiffness is
    then R K R^T. None stands for the identity. ``relative``, (n_cells,), are factors of the cells' stiffness.
    """
    of_nodes = assemble_stiffness(kinematics.mesh, material, relative)
    if rotation is not None:
        turn = sparse.kron(sparse.identity(kinematics.mesh.n_nodes), rotation, format="csr")
        of_nodes = (turn @ of_nodes @ turn.T).tocsr()
    return scale_rows(kinematics.project_matrix(of_nodes), row_weights)


def evaluate_plane_waves(nodes: Array, wavelength: float, axes: Array | None = None) -> Array:
    """Evaluate the waves v = e_a cos(2 pi x . e_b / l_c + phi) for all axes a, b and phi in {0, pi/2}.

    One wave a column, (n dim, 2 dim^2), node-major; the phase varies fastest, then b. Nodes, (n, dim), and the
    wavelength l_c are in pixels; the columns of ``axes``, (dim, dim), are the e_a, by default those of the image.
    """
    e = np.eye(nodes.shape[1]) if axes is None else axes
    along = nodes @ e
    return np.stack([np.outer(np.cos(2 * np.pi * x_b / wavelength + phi), e_a).ravel()
                     for e_a in e.T for x_b in along.T for phi in PHASES], axis=1)


def measure_gap_energies(mesh: Mesh, material: Material, interior_nodes: BoolArray, wavelength: float) -> Array:
    """Measure |K v|^2 of every plane wave on the interior nodes' rows, K never assembled.

    Square pixels, one for each column of ``evaluate_plane_waves``; the mesh is the whole region's, the wavelength l_c
    in pixels.
    """
    forces = sum_wave_forces(mesh, material, wavelength)
    rows = np.repeat(interior_nodes, mesh.dim)
    return np.asarray((forces[rows] ** 2).sum(axis=0))


def sum_wave_forces(mesh: Mesh, material: Material, wavelength: float) -> Array:
    """Sum the forces K v of every plane wave on the mesh's nodes, (n_dofs, n_waves), pixels, K never assembled."""
    waves = evaluate_plane_waves(mesh.nodes, wavelength, material.axes)
    forces = np.zeros_like(waves)
    for begin in range(0, mesh.n_cells, _GAP_CHUNK_CELLS):
        cells = np.arange(begin, min(begin + _GAP_CHUNK_CELLS, mesh.n_cells))
        part, node_ids = mesh.create_submesh(cells)
        dofs = (node_ids[:, None] * mesh.dim + np.arange(mesh.dim)).ravel()
        forces[dofs] += _wave_forces(part, material, waves[dofs])
    return forces


def measure_texture_energies(nodes: Array, hessian: sparse.csr_matrix, interior_nodes: BoolArray, wavelength: float,
                             axes: Array | None = None) -> Array:
    """Measure v^T M v of every plane wave on the interior nodes' rows; adds up over subdomains.

    Grey levels squared, one for each column of ``evaluate_plane_waves``. M, a subdomain's, is between the displacements
    of ``nodes``, node-major, grey levels squared per square pixel; nodes and the wavelength l_c are in pixels.
    """
    waves = evaluate_plane_waves(nodes, wavelength, axes)
    rows = np.repeat(interior_nodes, nodes.shape[1])
    return np.asarray((waves * (hessian @ waves))[rows].sum(axis=0))


def find_cut_off_weight(texture: Array, gap: Array) -> float:
    """Choose the weight eta at which texture and mechanics count alike at l_c: mean of |v^T M v| / |K v|^2 [LPHR11].

    The two phases of a wave are added up before the ratio, for one may vanish on all nodes; the mean is over a and b.
    eta is the weight of Eq. 10 of [BP17], in grey levels squared per square pixel, from ``measure_texture_energies``
    and ``measure_gap_energies`` on the same nodes.
    """
    n_phases = len(PHASES)
    texture_by_wave = np.abs(texture).reshape(-1, n_phases).sum(axis=1)
    gap_by_wave = gap.reshape(-1, n_phases).sum(axis=1)
    return float((texture_by_wave / gap_by_wave).mean())


def find_edge_weight(eta: float, probe: tuple[float, float], edge_wavelength: float) -> float:
    """Choose the weight, 0 to 1, of rows whose equilibrium is not imposed, relative to the others.

    eta grows as the fourth power of the wavelength, and the rows' weight enters as its square. ``probe`` is a
    wavelength, pixels, and the eta that belongs to it; below ``edge_wavelength``, pixels, equilibrium rules these rows:
    0 for never.
    """
    wavelength, eta_there = probe
    eta_of_edges = eta_there * (edge_wavelength / wavelength) ** 4
    return min(1.0, float(np.sqrt(eta_of_edges / eta)))


def _wave_forces(mesh: Mesh, material: Material, waves: Array) -> Array:
    """K v, (n_dofs, n_waves), of displacements v, the columns of waves."""
    cell_dofs = number_cell_dofs(mesh)
    by_cell = integrate_cell_stiffness(mesh, material) @ waves[cell_dofs]
    columns = [np.bincount(cell_dofs.ravel(), by_cell[..., wave].ravel(), minlength=mesh.n_dofs)
               for wave in range(waves.shape[1])]
    return np.stack(columns, axis=1)


@dataclass(frozen=True)
class HalfAmplitudes:
    """Wavelengths at which a wave of the displacement is measured with half of its amplitude.

    Attributes
    ----------
    shear, longitudinal : float
        Of waves across their direction and along it, pixels; of an orthotropic material along its stiffer axis.
    """

    shear: float
    longitudinal: float

    def describe(self) -> str:
        """Say it to the user, for the log and ``ddic check``."""
        return (f"waves of {self.shear:.4g} px (shear) and {self.longitudinal:.4g} px (longitudinal) keep half of "
                "their amplitude")


def find_half_amplitudes(material: Material, wavelength: float) -> HalfAmplitudes:
    """Find the wavelengths that eta of a cut-off wavelength halves, where texture and mechanics count alike.

    A wave of the length l_c loads its nodes in proportion to c, c = C11 or C22 along its direction and G12 across it,
    and one of another length in proportion to c (l_c / l)^2. As eta is the mean over these of v^T M v / |K v|^2, a wave
    is halved where c^2 (l_c / l)^4 mean(1 / c^2) = 1: on a mesh that is fine beside them, for texture without a
    direction. ``wavelength`` is l_c, pixels.
    """
    c11, c22, _, shear = material.moduli
    # Of dim^2 waves, dim are longitudinal.
    n_others = 1 if material.plane else 2
    mean = ((c11**-2 + c22**-2) / 2 + n_others * shear**-2) / (1 + n_others)
    return HalfAmplitudes(*(wavelength * (c**2 * mean) ** 0.25 for c in (shear, max(c11, c22))))


def scale_rows(matrix: sparse.csr_matrix, factors: Array) -> sparse.csr_matrix:
    """Multiply every row by a number, the matrix itself staying as it is.

    A product with a diagonal matrix takes ten times as long on a small matrix.
    """
    scaled = matrix.copy()
    scaled.data *= np.repeat(factors, np.diff(matrix.indptr))
    return scaled


ROWS_AT_ONCE = 1 << 16
"""Rows of which entries are squared at once. More take more memory, fewer more time."""


def sum_column_squares(matrix: sparse.csr_matrix, factors: Array) -> Array:
    """Sum the squares of each column, every row times a number: the diagonal of K^T diag(factors^2) K, (n_columns,)."""
    total = np.zeros(matrix.shape[1])
    for first in range(0, matrix.shape[0], ROWS_AT_ONCE):
        ends = matrix.indptr[first:first + ROWS_AT_ONCE + 1]
        entries = slice(ends[0], ends[-1])
        columns = matrix.indices[entries]
        if not len(columns):
            continue
        low = columns.min()
        of_rows = np.repeat(factors[first:first + ROWS_AT_ONCE] ** 2, np.diff(ends))
        sums = np.bincount(columns - low, matrix.data[entries] ** 2 * of_rows)
        total[low:low + len(sums)] += sums
    return total

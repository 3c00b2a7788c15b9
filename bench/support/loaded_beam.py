"""The open-hole beam of [BP17, 5.3] in tension and bending: its finite element displacement, images, mesh and case.

The hole is the paper's, 8 mm or 206 px across in an image of 6576 x 4384 px; where the beam lies in it, and its loads,
are chosen here so that elements of 15 px have about as many unknowns as the paper's mesh.
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

from bench.support.paper_case import BEAM, HEIGHT, SUBDOMAINS, WIDTH, make_once, name_images
from bench.support.paper_mesh import write_gmsh_mesh
from bench.support.runs import source_version
from ddic.functionals.regularization import Material, assemble_stiffness
from ddic.images.rigid import GridField
from ddic.io.mesh_file import read_mesh, write_mesh
from ddic.mesh.interpolation import interpolate
from ddic.mesh.mesh import Mesh, Similarity
from ddic.mesh.structured import build_structured_mesh
from ddic.solvers.local_system import LocalOperator
from ddic.synth.render import Digitiser, Picture, Scene, write_pair
from ddic.synth.speckle import SpeckleTexture

Array = NDArray[np.float64]

ELEMENT = 15.0
"""Side of the elements of a measurement, pixels."""

FINER = 2.0
"""Times smaller are those that the displacement is computed on; a larger value follows the hole more closely."""

SAMPLES = 3
"""Places an element's side, of a measurement, at which the displacement is kept."""

POISSON_RATIO = 0.3

NOISE = 2.0
"""Standard deviation of the images' noise, grey levels."""


@dataclass(frozen=True)
class Beam:
    """A beam in an image.

    Attributes
    ----------
    width, height : int
        Of the image, pixels.
    region : tuple of float
        x0, y0, x1, y1 of the beam, pixels.
    center, radius : tuple of float, float
        Of its hole, pixels.
    subdomains : int
        Of a measurement.
    strain : float
        Of the axis, by tension.
    curvature : float
        Of the axis, by bending, 1/px.
    by_gmsh : bool
        Whether Gmsh makes its meshes, as mixed ones of T3 and Q4; else they are ddic's regular ones.
    """

    width: int
    height: int
    region: tuple[float, float, float, float]
    center: tuple[float, float]
    radius: float
    subdomains: int
    strain: float = 1e-3
    curvature: float = 5e-6
    by_gmsh: bool = True

    @property
    def text(self) -> str:
        """What it is, in words."""
        x0, y0, x1, y1 = self.region
        cells = f"T3 and Q4 of {ELEMENT:g} px by Gmsh" if self.by_gmsh else f"ddic's regular mesh of {ELEMENT:g} px"
        return (f"beam of {x1 - x0:.0f} x {y1 - y0:.0f} px with a hole of {2 * self.radius:.0f} px in an image of "
                f"{self.width} x {self.height} px, 8 bit, noise of {NOISE:g} grey levels, {cells}, "
                f"{self.subdomains} subdomains")

    @property
    def mesh_file(self) -> str:
        """Name of the file of the mesh of a measurement."""
        return "beam.msh" if self.by_gmsh else "beam.vtu"

    def write_mesh(self, path: Path, element_size: float) -> None:
        """Write a mesh of elements of some size, pixels."""
        hole = (self.center, self.radius)
        if self.by_gmsh:
            write_gmsh_mesh(path, self.region, element_size, hole)
        else:
            write_mesh(path, build_structured_mesh(self.region, element_size, circles=[hole]))


PAPER_BEAM = Beam(WIDTH, HEIGHT, BEAM, (3287.5, 2191.5), 103.0, SUBDOMAINS)
SMALL_BEAM = Beam(1360, 460, (80.0, 80.0, 1280.0, 380.0), (679.5, 229.5), 50.0, 16, curvature=2.5e-5, by_gmsh=False)


@dataclass(frozen=True)
class LoadedField:
    """A displacement that is known on a grid, bilinear between its nodes and constant beyond it."""

    grid: GridField

    def displacement(self, points: Array) -> Array:
        """Displacement at points (n, 2), pixels."""
        return self.grid.at(points)

    def gradient(self, points: Array) -> Array:
        """Gradient at points (n, 2), shape (n, 2, 2): smoothed over two cells, near enough for Newton's method."""
        return self._slopes.at(points).reshape(-1, 2, 2)

    @cached_property
    def _slopes(self) -> GridField:
        grid = self.grid
        by_y, by_x = np.gradient(grid.values, grid.spacing[1], grid.spacing[0], axis=(0, 1))
        slopes = np.stack([by_x, by_y], axis=-1)
        return GridField(grid.origin, grid.spacing, slopes.reshape(*slopes.shape[:2], 4))


def load_beam(beam: Beam, folder: Path) -> LoadedField:
    """Compute the displacement of a beam by finite elements smaller than those of a measurement.

    Plane stress. Stresses on both ends are those of tension and bending far from the hole; all other edges are free.
    """
    path = folder / f"fine_{beam.mesh_file}"
    beam.write_mesh(path, ELEMENT / FINER)
    mesh = read_mesh(path, Similarity(), 2)
    u = _solve(mesh, _load_ends(beam, mesh))
    x0, y0, x1, y1 = beam.region
    columns, rows = (round(SAMPLES * side / ELEMENT) for side in (x1 - x0, y1 - y0))
    x, y = np.meshgrid(np.linspace(x0, x1, columns + 1), np.linspace(y0, y1, rows + 1))
    sampled = interpolate(mesh, u, np.column_stack([x.ravel(), y.ravel()])).reshape(*x.shape, 2)
    return LoadedField(GridField((x0, y0), ((x1 - x0) / columns, (y1 - y0) / rows), _continue_into_hole(sampled)))


def _load_ends(beam: Beam, mesh: Mesh) -> Array:
    """Forces on the nodes of both ends, (n_nodes, 2): stress E (strain + curvature (y - middle)), E = 1."""
    x0, y0, x1, y1 = beam.region
    forces = np.zeros((mesh.n_nodes, 2))
    for end, sign in ((x0, -1.0), (x1, 1.0)):
        nodes = np.flatnonzero(np.abs(mesh.nodes[:, 0] - end) < 1e-6)
        nodes = nodes[np.argsort(mesh.nodes[nodes, 1])]
        y = mesh.nodes[nodes, 1]
        stress = sign * (beam.strain + beam.curvature * (y - (y0 + y1) / 2))
        length = np.diff(y)
        forces[nodes[:-1], 0] += length * (2 * stress[:-1] + stress[1:]) / 6
        forces[nodes[1:], 0] += length * (stress[:-1] + 2 * stress[1:]) / 6
    return forces


def _solve(mesh: Mesh, forces: Array) -> Array:
    """Displacement of the nodes, (n_nodes, 2), without its mean motion."""
    stiffness = assemble_stiffness(mesh, Material(POISSON_RATIO))
    first, last = np.argmin(mesh.nodes[:, 0]), np.argmax(mesh.nodes[:, 0])
    free = np.setdiff1d(np.arange(mesh.n_dofs), [2 * first, 2 * first + 1, 2 * last + 1])
    operator = LocalOperator(stiffness[free][:, free].tocsr(), smallest_eigenvalue=0.0, where="the beam")
    u = np.zeros(mesh.n_dofs)
    try:
        u[free] = operator.solve(forces.ravel()[free])
    finally:
        operator.destroy()
    x, y = (mesh.nodes - mesh.nodes.mean(axis=0)).T
    one, zero = np.ones(len(x)), np.zeros(len(x))
    rigid = np.array([[one, zero], [zero, one], [-y, x]]).transpose(2, 1, 0).reshape(-1, 3)
    return np.asarray(u - rigid @ np.linalg.lstsq(rigid, u, rcond=None)[0]).reshape(-1, 2)


def _continue_into_hole(values: Array) -> Array:
    """Fill what is nan on a grid, (rows, columns, 2), by the solution of Laplace's equation with what is around it."""
    absent = np.isnan(values).any(axis=2).ravel()
    rows, columns = values.shape[:2]
    lines = [sparse.diags([1.0, -2.0, 1.0], [-1, 0, 1], shape=(n, n)) for n in (rows, columns)]
    laplacian = (sparse.kron(lines[0], sparse.eye(columns)) + sparse.kron(sparse.eye(rows), lines[1])).tocsr()[absent]
    flat = values.reshape(-1, 2).copy()
    flat[absent] = spsolve(laplacian[:, absent].tocsc(), -laplacian[:, ~absent] @ flat[~absent])
    return flat.reshape(values.shape)


@dataclass(frozen=True)
class BeamFiles:
    """What is on disk of a beam.

    Attributes
    ----------
    beam : Beam
        It.
    folder : Path
        Where reference.tif, deformed.tif and the mesh are.
    field : LoadedField
        The displacement between the images.
    """

    beam: Beam
    folder: Path
    field: LoadedField

    def write_case(self, wavelength: float, solver: str, gauss_newton: str = "") -> str:
        """Write the case of a cut-off wavelength, pixels, with keys of [solver] and of [gauss_newton].

        As in the paper all pixels count as both images show them, free edges are controlled, and loaded ends not at
        all; Gauss-Newton ends by the size of the whole correction alone.
        """
        x0, y0, x1, y1 = self.beam.region
        ends = [[x - 0.5, y0 - 0.5, x + 0.5, y1 + 0.5] for x in (x0, x1)]
        return (f'{name_images(self.folder / "reference.tif", self.folder / "deformed.tif")}'
                f'[mesh]\nfile = "{self.folder / self.beam.mesh_file}"\n'
                '[correlation]\ngrey_correction = "none"\nspoilt_pixels = "keep"\n'
                f"[regularization]\ncut_off_wavelength = {wavelength:g}\nnot_controlled = []\nboxes = {ends}\n"
                f"edge_wavelength = 0\npoisson_ratio = {POISSON_RATIO}\n"
                f"[gauss_newton]\nlargest_tolerance = 1e9\n{gauss_newton}\n[solver]\n{solver}\n")


def prepare_beam(beam: Beam, folder: Path) -> BeamFiles:
    """Give a beam's images and mesh, made where they are missing."""
    own = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
    make_once(folder, {**asdict(beam), "region": list(beam.region), "center": list(beam.center),
                       "source": [source_version(), own]}, partial(_make, beam, folder))
    with np.load(folder / "field.npz") as held:
        grid = GridField(tuple(held["origin"].tolist()), tuple(held["spacing"].tolist()), held["values"])
    return BeamFiles(beam, folder, LoadedField(grid))


def _make(beam: Beam, folder: Path) -> None:
    field = load_beam(beam, folder)
    np.savez(folder / "field.npz", origin=field.grid.origin, spacing=field.grid.spacing, values=field.grid.values)
    beam.write_mesh(folder / beam.mesh_file, ELEMENT)
    paths = folder / "reference.tif", folder / "deformed.tif"
    write_pair(paths, Scene(SpeckleTexture(), field), Picture(beam.width, beam.height, Digitiser(8, NOISE)))

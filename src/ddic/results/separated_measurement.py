"""A displacement measured by PGD-DIC, and how it was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.grey_statistics import GreyCorrection
from ddic.images.window import Window
from ddic.inputs.cameras import Camera, Frame
from ddic.inputs.inputs import Inputs
from ddic.io import result_schema as schema
from ddic.io.hdf5_stream import ChunkGrid
from ddic.io.result_writer import ResultWriter
from ddic.parallel.team import Team, require_held
from ddic.problem.separated_problem import SeparatedProblem
from ddic.problem.weighted_problem import ProblemSize
from ddic.results.provenance import describe_image
from ddic.results.residual_image import Patch, pack_chunks, stream_chunks
from ddic.results.separated_cells import OutputCells, write_output_cells
from ddic.results.separated_tables import write_separated_tables
from ddic.separated.corrections import SeparatedSolution
from ddic.separated.field import SeparatedField

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SeparatedMeasurement:
    """A measured displacement as a sum of products, known to all ranks; pixels are spread over them.

    Attributes
    ----------
    problem : SeparatedProblem
        What was measured: reference image, rectangle and settings.
    frame : Frame
        The deformed image.
    solution : SeparatedSolution
        The displacement and its corrections.
    cells : OutputCells
        On which the displacement is written out, with what the residual says of them.
    residual_rows : list of (range, (n_rows, width) array)
        Residual image of this rank's bands, grey levels.
    notes : tuple of str
        What the user should know.
    failure : str
        Why it is no result; empty where it converged.
    """

    problem: SeparatedProblem
    frame: Frame
    solution: SeparatedSolution
    cells: OutputCells
    residual_rows: list[tuple[range, NDArray[np.float32]]]
    notes: tuple[str, ...]
    failure: str = ""

    @property
    def grey_correction(self) -> GreyCorrection:
        """Correction of grey levels that was taken."""
        return self.problem.scheme.correction

    @property
    def team(self) -> Team:
        """All ranks."""
        return self.problem.team

    @property
    def inputs(self) -> Inputs:
        """Reference image and settings."""
        return self.problem.inputs

    @property
    def size(self) -> ProblemSize:
        """Sizes and weights."""
        return self.problem.size

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The camera with its reference image."""
        return self.inputs.cameras

    @property
    def unknowns(self) -> SeparatedField:
        """What another frame may start from."""
        return self.solution.field

    def at(self, points: Array) -> Array:
        """Evaluate the displacement.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n, 2) array
            Pixels; nan outside the rectangle.
        """
        return self.solution.field.at(points)

    def write(self, writer: ResultWriter | None) -> None:
        """Write the products, the displacement on cells, tables and the residual image; collective.

        Parameters
        ----------
        writer : ResultWriter or None
            Open on rank 0, None elsewhere.
        """
        self.team.build_on_root(lambda: self._write_on_root(require_held(writer)))
        if self.inputs.case.output.residual_image:
            self._write_residual_image(writer)

    def _write_on_root(self, writer: ResultWriter) -> None:
        write_output_cells(writer, self.cells, self.solution.field, self.inputs.case.images)
        writer.write_separated(self.solution.field)
        write_separated_tables(self, writer)
        writer.write_status(self.failure)

    def _write_residual_image(self, writer: ResultWriter | None) -> None:
        image, columns = self.cameras[0].reference.image, self.problem.rectangle.along_x.pixels
        grid = ChunkGrid(image.width, image.height)
        self.team.build_on_root(lambda: require_held(writer).create_residual_image(grid))
        patches = [Patch(Window(columns.start, rows.start, columns.stop, rows.stop), values)
                   for rows, values in self.residual_rows]
        chunks = pack_chunks(self.team, grid, [patch.window for patch in patches], iter(patches))
        stream_chunks(self.team, chunks, lambda chunk: require_held(writer).write_residual_chunk(chunk.number,
                                                                                               chunk.data))

    def describe_origin(self) -> dict[str, str | int]:
        """Say what it was measured from.

        Returns
        -------
        dict
            Sizes, and the images with their checksums.
        """
        return {"n_ranks": self.size.n_ranks, "n_subdomains": self.size.n_subdomains, "method": schema.PGD,
                **describe_image("reference", self.cameras[0].reference.image),
                **describe_image("deformed", self.frame[0].image)}

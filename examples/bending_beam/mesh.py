"""Write the mesh of a beam of 72 x 20 mm, elements of 1 mm, as a Gmsh file whose two ends have a name."""

import sys
from pathlib import Path

import meshio
import numpy as np

from ddic.mesh.structured import build_structured_mesh

ENDS, BODY = 1, 2


def main(path: Path) -> None:
    beam = build_structured_mesh((0, 0, 72, 20), 1)
    ends = []
    for name in ("left", "right"):
        column = beam.node_sets[name]
        ends.append(np.column_stack([column[:-1], column[1:]]))
    lines = np.concatenate(ends)
    tags = [np.full(beam.n_cells, BODY), np.full(len(lines), ENDS)]
    mesh = meshio.Mesh(
        np.column_stack([beam.nodes, np.zeros(beam.n_nodes)]),
        [("quad", beam.cells), ("line", lines)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"ends": np.array([ENDS, 1]), "beam": np.array([BODY, 2])},
    )
    meshio.write(path, mesh, file_format="gmsh22", binary=False)
    print(f"{path}: {beam.n_nodes} nodes, {beam.n_cells} cells")


main(Path(sys.argv[1]))

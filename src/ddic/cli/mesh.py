"""``ddic mesh``: write the mesh of a case."""

from pathlib import Path

import click

from ddic.cli.failures import failures_as_lines, take_closed_pipes_as_errors, warnings_as_lines
from ddic.errors import InputError


@click.command()
@click.argument("case_file", metavar="CASE.toml", type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False), metavar="MESH.vtu",
              help="File to write, .vtu or .inp.")
def mesh(case_file: Path, output: Path) -> None:
    """Write the mesh of a case file, with its node sets, as another case's mesh.file reads it: in pixels."""
    # Imported here because they bring meshio and OpenCV, which --help does not need.
    from ddic.case.loader import load_case
    from ddic.case.own_outputs import MESH, require_own_output
    from ddic.inputs.mesh_source import build_meshes
    from ddic.io.mesh_file import require_written_format, write_mesh
    from ddic.io.volume_file import hold_source

    take_closed_pipes_as_errors()
    with failures_as_lines(output), warnings_as_lines():
        require_written_format(output)
        loaded = load_case(case_file)
        require_own_output(output, MESH, loaded.list_inputs())
        image = hold_source(loaded.case.imaging.reference, loaded.case.dim)
        built, tying = build_meshes(loaded.case, image.extent)
        if tying is not None:
            raise InputError(f"{case_file}: near.mesh: meshes that do not match are not one that mesh.file could read; "
                             "leave near.mesh out")
        write_mesh(output, built)
    sets = ", ".join(f"{name} ({len(nodes)} nodes)" for name, nodes in built.node_sets.items() if len(nodes))
    for name, value in (("mesh", f"{built.n_nodes} nodes, {built.n_cells} cells"), ("node sets", sets or "none"),
                        ("written", output)):
        click.echo(f"{name:<20}{value}")

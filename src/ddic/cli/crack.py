"""``ddic crack``: the tip of a crack and its stress intensity factors."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from ddic.cli.errors_as_lines import errors_as_lines
from ddic.cli.frame_option import add_frame_option
from ddic.cli.warned import warnings_as_lines

if TYPE_CHECKING:
    from ddic.fracture.crack_tip import CrackTip


@click.command()
@click.argument("file", metavar="RESULT", type=click.Path(path_type=Path))
@add_frame_option
@click.option("--line", type=int, default=1, show_default=True, help="Number of the discontinuity in the case.")
@click.option("--tip", type=float, nargs=2, default=None, help="Where the tip may be, px; by default the line's end.")
@click.option("--inner", type=float, default=None, help="Radius about the tip within which nothing counts, px.")
@click.option("--outer", type=float, default=None, help="Radius about the tip up to which cells count, px.")
@click.option("--poisson-ratio", type=click.FloatRange(0.0, 0.5), default=0.3, show_default=True, help="nu.")
@click.option("--plane", type=click.Choice(["stress", "strain"]), default="stress", show_default=True,
              help="Plane stress or plane strain.")
@click.option("--shear-modulus", type=click.FloatRange(0.0, min_open=True), default=None,
              help="mu in any unit of stress: factors are printed in it too, with the pixel size of the case.")
def crack(file: Path, frame: int | None, line: int, tip: tuple[float, float] | None, inner: float | None,
          outer: float | None, poisson_ratio: float, plane: Literal["stress", "strain"],
          shear_modulus: float | None) -> None:
    """Find the tip of a crack on the straight end of its line, K_I, K_II and T, by a fit of Williams' series."""
    # Imported here because HDF5 is not needed by --help.
    from ddic.fracture.crack_tip import Ring, find_crack_tip
    from ddic.io.series_reader import read_frame

    with errors_as_lines():
        with warnings_as_lines():
            result = read_frame(file, frame)
        found = find_crack_tip(result, line, tip=tip, poisson_ratio=poisson_ratio, plane=plane,
                               ring=Ring(inner, outer))
    units = result.attributes.get("units", {})
    for name, value in _lines(found, shear_modulus, float(units.get("pixel_size", 1.0)),
                              str(units.get("length_unit", "px"))):
        click.echo(f"{name:<16}{value}")


def _lines(found: CrackTip, shear_modulus: float | None, pixel_size: float, unit: str) -> list[tuple[str, str]]:
    """Names and values of what is printed."""
    import numpy as np

    x, y = found.position
    lines = [
        ("tip", f"({x:.2f}, {y:.2f}) px, crack at {np.rad2deg(found.angle):.2f} degrees from +x to +y"),
        ("K_I / mu", f"{found.opening_factor:.5g} px^(1/2)"),
        ("K_II / mu", f"{found.sliding_factor:.5g} px^(1/2)"),
        ("T / mu", f"{found.t_stress:.5g}"),
    ]
    if shear_modulus is not None:
        factor = shear_modulus * np.sqrt(pixel_size)
        lines += [("K_I", f"{factor * found.opening_factor:.5g} [mu] {unit}^(1/2)"),
                  ("K_II", f"{factor * found.sliding_factor:.5g} [mu] {unit}^(1/2)"),
                  ("T", f"{shear_modulus * found.t_stress:.5g} [mu]")]
    return [*lines, ("ring", f"{found.n_cells} cells between {found.inner:.0f} and {found.outer:.0f} px of the tip"),
            ("left over", f"{found.rms:.2g} px RMS beside the series")]

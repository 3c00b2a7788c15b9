"""Kinds of pictures, what can be asked of each, and what their files are called; without matplotlib."""

from typing import Literal

CURVES = "curves"
KINDS = ("partition", "deformed", "displacement", "strain", "sigma", "bias", "simulation", "residual",
         "signed-residual", "histogram", "independent", "difference", "krylov", "opening", "detection", "near-far",
         "modes", "corrections", "line")
ONLY_ASKED_FOR = ("displacement", "signed-residual", "histogram", "line")
"""Kinds that show again, in another form or along a line, what others of ``all`` show."""

OVER_IMAGE = ("partition", "displacement", "strain", "sigma", "bias", "simulation")
WITH_COMPONENT = ("deformed", "independent", "displacement", "sigma", "bias", "simulation", "difference", "near-far")
WITH_LIMITS = ("deformed", "independent", "displacement", "strain", "sigma", "bias", "simulation", "residual",
               "signed-residual", "difference", "detection")
ON_SLICES = (*OVER_IMAGE, "residual", "signed-residual", "difference")
"""Kinds that show slices of a volume."""

ANIMATED = ("deformed", "displacement", "strain", "residual", "signed-residual")
COMPONENTS: tuple[Literal["x", "y", "z", "magnitude"], ...] = ("x", "y", "z", "magnitude")
NUMBERS = ("xx", "yy", "zz", "xy", "yz", "xz", "principal-1", "principal-2", "principal-3", "von-mises")
"""What of a strain is drawn."""

OF_VOLUMES = ("z", "zz", "yz", "xz", "principal-3")
"""Those components and strains that a plane result does not have."""

MEASURES = ("infinitesimal", "green-lagrange", "hencky")


def format_name(kind: str, component: str, number: str | None = None, measure: str = MEASURES[0],
                 line: tuple[float, ...] = (), slices: tuple[tuple[str, float], ...] = (), *,
                by_cell: bool = False) -> str:
    """Name a picture by what it shows, so that none takes the place of another: ``strain_yy``, ``displacement_x_z120``.

    ``number`` is one of NUMBERS, None for all of them; ``line`` are the ends of a line, ``slices`` those asked for.
    """
    parts = [kind]
    if kind == "strain":
        parts += [number] if number is not None else []
        parts += [measure] if measure != MEASURES[0] else []
        parts += ["by_cell"] if by_cell else []
    elif kind == "sigma" and number is not None:
        parts.append(number)
    elif kind in WITH_COMPONENT and component != "magnitude":
        parts.append(component)
    elif kind == "line":
        parts += [f"{value:g}" for value in line]
    if kind in ON_SLICES:
        parts += [f"{axis}{place:g}" for axis, place in slices]
    return "_".join(parts)

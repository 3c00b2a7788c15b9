"""Units of lengths in figures: pixels, or the case's length unit where the size of a pixel is known."""

from __future__ import annotations

from dataclasses import dataclass

from ddic.errors import InputError
from ddic.io import result_schema as schema
from ddic.io.result_reader import Result


@dataclass(frozen=True)
class LengthUnit:
    """A unit of lengths.

    Attributes
    ----------
    size : float
        Of a pixel, in this unit.
    name : str
        As labels have it.
    """

    size: float = 1.0
    name: str = "px"


PIXELS = LengthUnit()


def find_length_unit(result: Result, asked: str | None = None) -> LengthUnit:
    """Find the unit in which a result is drawn.

    Parameters
    ----------
    result : Result
        With or without the size of a pixel.
    asked : str, optional
        ``px`` or ``physical``; where it is left out, physical if the size of a pixel is known.

    Returns
    -------
    LengthUnit
        For axes and displacements.

    Raises
    ------
    InputError
        Where the case's unit is asked for and the result has none.
    """
    known = schema.DISPLACEMENT_PHYSICAL in result.point_data
    if asked == "physical" and not known:
        raise InputError(f"{result.path}: --units physical: measured without images.pixel_size; give it in the case "
                         "and run again, or draw in px")
    if asked == "px" or not known:
        return PIXELS
    units = result.attributes[schema.UNITS]
    return LengthUnit(float(units["pixel_size"]), str(units["length_unit"]))

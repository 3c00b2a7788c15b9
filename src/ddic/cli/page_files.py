"""Files of pages that ``ddic plot`` draws: names and formats."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ddic.errors import InputError

FORMATS = ("png", "pdf", "svg")
MOVING = ("gif", "mp4")
"""Formats of animations."""


@dataclass(frozen=True)
class PageFiles:
    """Where pages are written.

    Attributes
    ----------
    folder : Path
        Of all of them.
    stem : str
        Beginning of their names.
    ending : str
        Their format.
    dpi : int
        Dots an inch.
    """

    folder: Path
    stem: str
    ending: str
    dpi: int

    def to_path(self, *words: str) -> Path:
        """Name a file by what it shows.

        Parameters
        ----------
        *words : str
            Put between the beginning and the ending.

        Returns
        -------
        Path
            In the folder.
        """
        return self.folder / ".".join((self.stem, *words, self.ending))


def choose_ending(asked: str | None, *, animate: bool) -> str:
    """Choose a format.

    Parameters
    ----------
    asked : str or None
        By the user.
    animate : bool
        Whether it is an animation.

    Returns
    -------
    str
        One of FORMATS, or of MOVING.

    Raises
    ------
    InputError
        Where the one that is asked for does not fit, or there is no program for it.
    """
    from ddic.plots.series import require_writer

    fitting = MOVING if animate else FORMATS
    if asked is not None and asked not in fitting:
        what = "an animation is" if animate else "without --animate a picture is"
        raise InputError(f"--format {asked}: {what} one of {', '.join(fitting)}")
    ending = asked or fitting[0]
    require_writer(ending)
    return ending

"""The deformed images of a series, opened one frame at a time."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ddic.case.frame_files import list_cameras, list_deformed
from ddic.io.file_stamps import FileStamps
from ddic.parallel.team import Team
from ddic.problem.cameras import Frame, open_frame, open_on_all_ranks
from ddic.problem.inputs import Inputs


@dataclass(frozen=True)
class FrameOpener:
    """Opens frames of a series by their numbers, which count from 1.

    Attributes
    ----------
    team : Team
        All ranks.
    inputs : Inputs
        With the case of the whole series.
    first_number : int
        Of a frame that is open already, from 1.
    first : Frame
        Its images.
    stamps : FileStamps
        Of the images when they were checked.
    """

    team: Team
    inputs: Inputs
    first_number: int
    first: Frame
    stamps: FileStamps = field(default_factory=FileStamps)

    @property
    def n_frames(self) -> int:
        """Of the series."""
        return len(list_deformed(self.inputs.case.images))

    def open(self, number: int) -> Frame:
        """Open the images of a frame; collective.

        Parameters
        ----------
        number : int
            From 1.

        Returns
        -------
        Frame
            One deformed image of each camera.

        Raises
        ------
        InputError
            On all ranks, where one cannot be read.
        """
        if number == self.first_number:
            return self.first
        return open_frame(self.inputs.case, open_on_all_ranks(self.team), number - 1)

    def list_files(self, number: int) -> list[Path]:
        """List the images of a frame; none behind the last.

        Parameters
        ----------
        number : int
            From 1.

        Returns
        -------
        list of Path
            One of each camera.
        """
        if number > self.n_frames:
            return []
        return [list_deformed(section)[number - 1] for section in list_cameras(self.inputs.case)]

    def choose_stamps(self, number: int) -> FileStamps:
        """Choose the stamps of what a frame is measured from.

        Parameters
        ----------
        number : int
            From 1.

        Returns
        -------
        FileStamps
            Of its images and the reference images.
        """
        references = [section.reference for section in list_cameras(self.inputs.case)]
        return self.stamps.choose([*references, *self.list_files(number)])

    def describe(self, number: int) -> str:
        """Describe a frame by the far camera's image.

        Parameters
        ----------
        number : int
            From 1.

        Returns
        -------
        str
            Its file.
        """
        return str(list_deformed(self.inputs.case.images)[number - 1])

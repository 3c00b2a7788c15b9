"""The session that frames of a series are measured in, and another one where a frame becomes the reference image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Self

from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.methods.dd_dic import Session
from ddic.methods.recipe import NoiseFloor
from ddic.problem.reference_problem import update_reference
from ddic.results.measurement import Measurement
from ddic.results.series import FrameRecord, MeasuredState, Vertices
from ddic.results.series_images import SeriesImages


class ReferenceSession:
    """The session of one reference image; use it in a ``with`` statement.

    Parameters
    ----------
    images : SeriesImages
        Of the series.
    session : Session
        Prepared; it is closed with this one.
    frame : int, optional
        Whose image is the reference image; 0, by default, for the first one.
    noise_floor : float, optional
        RMS displacement that noise leaves in the field of that frame, pixels.
    lines : tuple of tuple of (x, y), optional
        Vertices of the discontinuities that it was prepared with, pixels; those of the case by default.
    """

    def __init__(self, images: SeriesImages, session: Session, frame: int = 0, noise_floor: float = 0.0,
                 lines: tuple[Vertices, ...] = ()) -> None:
        self.images, self.session, self.frame, self.lines = images, session, frame, lines
        self._noise_floor = noise_floor
        self._added = NoiseFloor(session, images.clock)

    @classmethod
    def prepare(cls, images: SeriesImages, lines: tuple[Vertices, ...], first_frame: Frame | None = None) -> Self:
        """Prepare the session of the first reference image, the caller's to close; collective.

        ``lines`` are vertices of the discontinuities as a frame has refined them, pixels; empty for those of the case.
        ``first_frame`` is given where it is known already. Raises InputError, SingularSubdomainError or
        FactorizationError on all ranks.
        """
        inputs = place_lines(images.opener.inputs, lines)
        return cls(images, Session(images.team, inputs, images.listener, images.clock, first_frame), lines=lines)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def estimate_noise_floor(self, measurement: Measurement) -> float:
        """Estimate what noise leaves in a frame's field, with what it has left in those of updates; collective.

        Returns the RMS of a component at a node, pixels; nan where a linear step fails.
        """
        return math.hypot(self._noise_floor, self._added.estimate(measurement))

    def update(self, record: FrameRecord, state: MeasuredState) -> ReferenceSession:
        """Prepare a session that compares with a frame that was measured; collective.

        This one stays; the other one is the caller's to close. ``state`` is the frame's field on this session's
        subdomains. Raises InputError, SingularSubdomainError or FactorizationError on all ranks, where the mesh has
        left the frame, or the frame does not hold it.
        """
        images, reference = self.images, self.session.problem.reference
        displacement = state.gather(images.team, reference.subdomains, reference.region.n_nodes)
        frame = images.opener.open(record.number)
        inputs = update_reference(images.team, reference, frame, displacement)
        session = Session(images.team, inputs, images.listener, images.clock)
        return ReferenceSession(images, session, record.number, record.noise_floor_px)

    def restrict_states(self, other: ReferenceSession, states: Sequence[MeasuredState]) -> list[MeasuredState]:
        """Restrict states on another session's subdomains to this one's; collective.

        None are left where other lines cut the mesh.
        """
        if other is self:
            return list(states)
        if other.lines != self.lines:
            return []
        before, now = other.session.problem.reference, self.session.problem.reference
        fields = [state.gather(self.images.team, before.subdomains, before.region.n_nodes) for state in states]
        return [state.restrict(field, now.subdomains) for state, field in zip(states, fields, strict=True)]

    def close(self) -> None:
        """Free PETSc's objects."""
        self.session.close()


def place_lines(inputs: Inputs, lines: tuple[Vertices, ...]) -> Inputs:
    """Put the discontinuities of a case where a frame has refined them.

    ``lines`` are the vertices of all of them, pixels; empty where they stay.
    """
    if not lines:
        return inputs
    sections = tuple(section.model_copy(update={"vertices": vertices})
                     for section, vertices in zip(inputs.case.discontinuity, lines, strict=True))
    return replace(inputs, case=inputs.case.model_copy(update={"discontinuity": sections}))

"""The frames of a series that are finished, as far as the next one needs them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ddic.methods.reference_session import ReferenceSession
from ddic.results.series import N_STATES, FrameRecord, MeasuredState


@dataclass(frozen=True)
class FramesSoFar:
    """What the next frame goes on from.

    Attributes
    ----------
    session : ReferenceSession
        Of the reference image in use.
    records : sequence of FrameRecord
        Of all frames so far, in order.
    states : sequence of MeasuredState
        Of the last that were measured, two at most, on the session's subdomains.
    """

    session: ReferenceSession
    records: Sequence[FrameRecord]
    states: Sequence[MeasuredState]

    def add(self, session: ReferenceSession, record: FrameRecord, state: MeasuredState | None) -> FramesSoFar:
        """Add a frame; collective. The session so far is closed where another one has taken its place.

        Parameters
        ----------
        session : ReferenceSession
            That measured it.
        record : FrameRecord
            Of it.
        state : MeasuredState or None
            None where it could not be measured.

        Returns
        -------
        FramesSoFar
            With it.
        """
        states = session.restrict_states(self.session, self.states)
        if session is not self.session:
            self.session.close()
        states = states if state is None else [*states, state]
        return FramesSoFar(session, [*self.records, record], states[-N_STATES:])

    def find_last_measured(self) -> FrameRecord | None:
        """Find the last frame that was measured.

        Returns
        -------
        FrameRecord or None
            None where none was, or where nothing is known of its field.
        """
        measured = [record for record in self.records if record.converged]
        return measured[-1] if measured and self.states else None

"""One element size and cut-off wavelength: prepared, and measured with."""

from __future__ import annotations

from ddic.errors import DdicError, is_collective
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.io.result_reader import Result
from ddic.methods.dd_dic import Session
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Silence
from ddic.results.publishing import gather
from ddic.results.sweep_candidates import CandidateField, collect_candidate_field
from ddic.start.given_start import EarlierResult


class CandidateSession:
    """A candidate, prepared at its first measurement; use it in a ``with`` statement.

    Parameters
    ----------
    team : Team
        All ranks.
    inputs : Inputs
        With the candidate's case and mesh.
    stays_open : bool
        Whether images, M and factors are kept from one measurement to the next.
    """

    def __init__(self, team: Team, inputs: Inputs, *, stays_open: bool) -> None:
        self._team, self._inputs, self._stays_open = team, inputs, stays_open
        self._session: Session | None = None

    def __enter__(self) -> CandidateSession:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def measure_pair(self, frame: Frame, start: EarlierResult | None) -> CandidateField:
        """Measure the pair of the case; collective.

        Parameters
        ----------
        frame : Frame
            The deformed image.
        start : EarlierResult or None
            A displacement to start from; None: it is searched for.

        Returns
        -------
        CandidateField
            With the reason where nothing was measured: one candidate that fails ends no sweep.
        """
        try:
            session = self._open()
            return collect_candidate_field(session.problem, session.measure(frame, start))
        except DdicError as error:
            # What this rank alone raises must end the job.
            if not is_collective(error):
                raise
            self.close()
            return CandidateField(None, failure=str(error))
        finally:
            self._finish()

    def measure_virtual(self, frame: Frame, start: EarlierResult) -> Result | None:
        """Measure a virtual image; collective.

        Parameters
        ----------
        frame : Frame
            The virtual image.
        start : EarlierResult
            A displacement to start from.

        Returns
        -------
        Result or None
            The field, on every rank; None where there is none.
        """
        try:
            return gather(self._open().measure(frame, start))
        except DdicError as error:
            if not is_collective(error):
                raise
            self.close()
            return None
        finally:
            self._finish()

    def close(self) -> None:
        """Free the factors."""
        if self._session is not None:
            self._session.close()
        self._session = None

    def _open(self) -> Session:
        if self._session is None:
            self._session = Session(self._team, self._inputs, Silence(), PhaseClock(waiting=self._team.waiting))
        return self._session

    def _finish(self) -> None:
        if not self._stays_open:
            self.close()

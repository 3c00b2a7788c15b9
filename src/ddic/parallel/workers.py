"""Ranks that work for one of them, which alone knows what comes next."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from ddic.parallel.team import Team, make_portable

Held = TypeVar("Held")
Item = TypeVar("Item")
Found = TypeVar("Found")
Own = TypeVar("Own")

_Asked = tuple[Callable[[Any, Any], Any], list[Any]]
"""What is to be done, and with which items."""


@dataclass(frozen=True, eq=False)
class Workers(Generic[Held]):
    """A team of which one rank leads and all work: the others wait for what it asks of them.

    Attributes
    ----------
    team : Team
        All ranks.
    leader : int
        The rank that leads.
    held : object
        What this rank works with.
    """

    team: Team
    leader: int
    held: Held

    def run(self, lead: Callable[[], Found], before: Callable[[], Own]) -> tuple[Own, Found | None]:
        """Run ``lead`` on the leader, where it may call ``map``; collective.

        Each rank does work of its own ``before``. Gives what that returned, and on the leader what ``lead`` did. Raises
        on all ranks what the lowest rank that fails raises.
        """
        is_leader = self.team.rank == self.leader
        found: Found | None = None
        error: Exception | None = None
        try:
            own = before()
            if is_leader:
                found = lead()
        except Exception as caught:
            error = caught
        if is_leader:
            self.team.scatter([None] * self.team.size, self.leader)
        else:
            self._serve(error)
        # Does not return where this rank has nothing of its own.
        self.team.share_error(error)
        return own, found

    def map(self, work: Callable[[Held, Item], Found], items: Sequence[Item]) -> list[Found]:
        """Run a function of a module on each item, in turn on all ranks; called by the leader, inside ``run``.

        Neighbouring items go to the same rank, the last ones to the last. Raises what the lowest rank that fails
        raises.
        """
        team = self.team
        shares = np.array_split(np.arange(len(items)), team.size)
        of_ranks = [(work, [items[k] for k in mine]) for mine in shares]
        own = team.scatter(of_ranks, self.leader)
        outcomes = team.gather_to(self._attempt(own), self.leader)
        found: list[Found] = []
        for outcome in outcomes or ():
            if isinstance(outcome, Exception):
                raise outcome
            found.extend(outcome)
        return found

    def _serve(self, error: Exception | None) -> None:
        """Work until the leader has ended; with an error, only tell it."""
        while True:
            asked: _Asked | None = self.team.scatter(None, self.leader)
            if asked is None:
                return
            outcome = self._attempt(asked) if error is None else make_portable(error, self.team.rank)
            self.team.gather_to(outcome, self.leader)

    def _attempt(self, asked: _Asked) -> list[Any] | Exception:
        """What the work gives, or an error as other ranks can receive it."""
        work, items = asked
        try:
            return [work(self.held, item) for item in items]
        except Exception as error:
            return make_portable(error, self.team.rank)

"""A number of a paper beside ours: what a chapter of ``bench.papers`` finds, as a line of docs/papers.md or a row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bench.support.rows import Row

UNREAD = "drawn; no number is read from it"
"""Of a figure of a paper whose values its text does not give."""

UNKNOWN = "a number is not known here"
"""Of what a paper may tell, and what is cited of it does not."""


@dataclass(frozen=True)
class Compared:
    """A number of a paper beside ours, in the same norm and with the same settings, or with what differs said.

    Attributes
    ----------
    place : str
        Where the paper has it: "[BP17, section 5.3]", "[PP12, Fig. 4]".
    what : str
        What is compared.
    setting : str
        The case: images, elements, and every setting that is not a default. Numbers that follow each other with one
        setting are shown in one table below it.
    paper, ours : str
        What the paper has, and what is found here.
    why : str
        What differs and why; empty where nothing does.
    bound : str
        What ours is judged against; empty where it is only reported.
    holds : bool
        Whether it is within the bound.
    judged_small : bool
        Whether the bound is one for the tiny case of a smoke run too.
    """

    place: str
    what: str
    setting: str
    paper: str
    ours: str
    why: str = ""
    bound: str = ""
    holds: bool = True
    judged_small: bool = False

    def to_row(self) -> Row:
        """Turn into a row of an acceptance table."""
        bound = self.bound or "reported beside the paper's"
        measured = f"{self.ours}; the paper's: {self.paper}" + (f" ({self.why})" if self.why else "")
        return Row(f"{self.place} {self.what}; {self.setting}", bound, measured, self.holds, self.judged_small)


def format_tables(found: Sequence[Compared]) -> str:
    """Format numbers as tables of Markdown, one for each setting, which stands above it."""
    lines: list[str] = []
    setting = None
    for one in found:
        if one.setting != setting:
            setting = one.setting
            lines += ["", f"{setting[0].upper()}{setting[1:]}:", "",
                      "| | what | the paper | ddic | what differs |", "|---|---|---|---|---|"]
        ours = f"{one.ours} ({one.bound})" if one.bound else one.ours
        # A bar would end the cell.
        cells = [cell.replace("|", r"\|") for cell in (one.place, one.what, one.paper, ours, one.why)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, ""])

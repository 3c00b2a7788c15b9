"""What a report states: items that belong together, and the words for what is not known."""

from __future__ import annotations

from dataclasses import dataclass

NOT_RECORDED = "not recorded"
"""In place of a value that the result does not hold."""

NOT_STATED = "not stated in the case"
"""In place of a value that only the user knows."""

Items = list[tuple[str, str]]
"""What is stated, and its value."""


@dataclass(frozen=True)
class Statement:
    """Items that belong together.

    Attributes
    ----------
    title : str
        Above them.
    items : list of (str, str)
        Name and value of each.
    """

    title: str
    items: Items

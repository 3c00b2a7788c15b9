"""Sums that are rounded alike however their terms are spread: in pairs of neighbours, pairs of pairs and so on."""

from collections.abc import Iterable

from ddic.arrays import Array

Place = tuple[int, int]
"""Level and number of a group of terms: group i of level l holds the terms i 2^l to (i + 1) 2^l - 1."""

Groups = dict[Place, Array]
"""Sums of groups that wait for a neighbour; two neighbours become one group as soon as both are there."""


def sum_neighbours(first: int, terms: Iterable[Array]) -> Groups:
    """Add up arrays of one shape whose numbers follow each other from ``first``, as far as neighbours are there."""
    groups: Groups = {}
    for number, values in enumerate(terms, start=first):
        _add(groups, (0, number), values)
    return groups


def merge_groups(some: Groups, others: Groups) -> Groups:
    """Join groups of different terms, those that are neighbours added up."""
    groups = dict(some)
    for place, values in others.items():
        _add(groups, place, values)
    return groups


def sum_groups(groups: Groups) -> Array:
    """Sum the groups of all terms; one is left where the number of terms is a power of 2."""
    total, *others = (groups[place] for place in sorted(groups, key=_find_first_term))
    return sum(others, start=total)


def _add(groups: Groups, place: Place, values: Array) -> None:
    """Add a group's sum."""
    level, number = place
    neighbour = groups.pop((level, number ^ 1), None)
    if neighbour is None:
        groups[place] = values
        return
    first, second = (neighbour, values) if number % 2 else (values, neighbour)
    _add(groups, (level + 1, number // 2), first + second)


def _find_first_term(place: Place) -> int:
    level, number = place
    return number << level

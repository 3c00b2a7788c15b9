"""All acceptance tables: ``make accept-TABLE`` measures one, and the module ``accept.TABLE`` holds its ``CHECKS``."""

from __future__ import annotations

import importlib

from accept.table import Check

TABLES = ("performance", "near-far", "house", "practice", "faults", "impressions", "core", "start", "right", "pgd",
          "xdic", "trust", "solver", "clean")
"""Names of all tables, those first that take longest on tiny cases."""


def module_of(table: str) -> str:
    """Give the module of a table.

    Parameters
    ----------
    table : str
        Of TABLES.

    Returns
    -------
    str
        Dotted name.
    """
    return f"accept.{table.replace('-', '_')}"


def find_checks(table: str) -> dict[str, Check]:
    """Give the checks of a table.

    Parameters
    ----------
    table : str
        Of TABLES.

    Returns
    -------
    dict
        Checks by name, in the order in which they are measured.
    """
    return dict(importlib.import_module(module_of(table)).CHECKS)

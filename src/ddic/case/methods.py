"""Which method a case asks for: the registry of methods.

A method is named by its module, which is imported where a case asks for it. So a run loads no other method, and what
lies below ``ddic.methods``, as checks do, can ask the method of a case too.
"""

from importlib import import_module
from typing import Any

from ddic.case.schema import Case

METHODS = {"pgd": "ddic.methods.pgd_dic"}
"""Module of a method by the section of a case that asks for it; its METHOD is a ``ddic.methods.method.Method``."""

ON_A_MESH = "ddic.methods.fe_dic"
"""Module of the method of a case with none of these sections."""


def find_method_section(case: Case) -> str | None:
    """Find the section by which a case asks for a method; None for finite elements on a mesh."""
    return next((section for section in METHODS if getattr(case, section, None) is not None), None)


def find_method(case: Case) -> Any:
    """Import the method that a case asks for, a ``ddic.methods.method.Method``."""
    section = find_method_section(case)
    module = ON_A_MESH if section is None else METHODS[section]
    return import_module(module).METHOD

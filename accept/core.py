"""The acceptance table of the core: every check measured here and now; exit 1 where one falls short.

Usage: accept_core.py [NAME ...], with the names of the checks' own scripts; all by default.
"""

from __future__ import annotations

import importlib
import sys

CHECKS = ("accuracy", "demo_noise", "linear_step", "preconditioners", "openhole", "sample14", "full_size")


if __name__ == "__main__":
    sys.exit(accept("core", sys.argv[1:], CHECKS, lambda name: importlib.import_module(name).measure()))

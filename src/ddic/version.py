"""The version of ddic, which the result file records."""

from __future__ import annotations

__version__ = "0.1.0"

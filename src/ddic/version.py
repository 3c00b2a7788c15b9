"""The version of ddic, which the result file records."""

__version__ = "0.1.0"

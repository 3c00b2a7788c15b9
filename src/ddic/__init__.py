"""Finite element digital image correlation by dual domain decomposition."""

__version__ = "0.1.0"

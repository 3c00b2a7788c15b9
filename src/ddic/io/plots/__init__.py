"""Figures of a result, one per module; each function returns a figure and saves nothing."""

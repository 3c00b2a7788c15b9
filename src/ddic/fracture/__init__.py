"""Cracks: what a measured field says of a tip."""

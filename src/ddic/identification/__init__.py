"""Constitutive parameters from the images of a specimen and the forces on it."""

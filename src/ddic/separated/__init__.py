"""Displacements as sums of products of one-dimensional functions: PGD-DIC [PP12], on one rank or on bands of rows."""

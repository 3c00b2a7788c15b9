"""Correlation, elasticity and the equilibrium gap."""

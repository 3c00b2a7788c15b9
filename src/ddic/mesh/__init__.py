"""Meshes, shape functions and rasterization."""

"""From unknowns to displacements at points."""

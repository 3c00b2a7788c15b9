"""From unknowns to displacements of nodes, and strain."""

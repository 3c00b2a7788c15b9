"""Linear steps, Gauss-Newton and the start of the displacement."""

"""Images, their windows, splines and coarse-grained versions."""

"""What measures: methods, lines that images correct, series, sweeps."""

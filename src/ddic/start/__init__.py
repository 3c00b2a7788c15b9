"""The displacement that Gauss-Newton starts from."""

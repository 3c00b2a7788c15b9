"""Benchmarks: what ddic takes and reaches, measured; ``python -m bench.NAME`` from the repository."""

"""Measurement methods, one recipe each."""

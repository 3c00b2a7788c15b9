"""Discontinuities found by themselves: where a line lies that the displacement jumps across [RHR08]."""

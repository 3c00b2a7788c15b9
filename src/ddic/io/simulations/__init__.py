"""Displacement fields that finite element programs have computed."""

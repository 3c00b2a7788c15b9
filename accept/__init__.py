"""Acceptance: tables of checks with a bound, measured here and now; a non-zero exit where one falls short."""

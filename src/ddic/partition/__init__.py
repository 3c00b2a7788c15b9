"""Subdomains and what they share."""

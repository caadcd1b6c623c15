"""Errors of air data."""

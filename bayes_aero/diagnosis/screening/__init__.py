"""Scores of all candidates."""

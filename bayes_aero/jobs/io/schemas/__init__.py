"""Schemas of the JSON files."""

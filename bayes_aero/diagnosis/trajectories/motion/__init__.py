"""Modes of motion of a fitted model."""

"""Modes of motion of a fitted model, and objective tests of its responses."""

"""Trajectories before and after the extension of a model."""

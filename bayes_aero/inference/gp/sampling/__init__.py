"""Sampled hyperparameters."""

"""Causes in a band of frequencies, where bias and drift drop out."""

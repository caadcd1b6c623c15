"""Errors of recorded channels."""

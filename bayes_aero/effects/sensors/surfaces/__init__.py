"""Errors of recorded surface deflections."""

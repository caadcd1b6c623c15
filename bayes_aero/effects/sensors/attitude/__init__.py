"""Errors of attitude sensors."""

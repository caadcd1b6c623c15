"""Errors of inertial sensors."""

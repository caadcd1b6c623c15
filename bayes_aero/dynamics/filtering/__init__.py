"""Disturbed systems: the extended Kalman filter and innovations of segments of flight."""

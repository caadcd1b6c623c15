"""Consistency of the sensors along the flight path."""

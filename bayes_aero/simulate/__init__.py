"""Simulated records: request, manoeuvres, sensors and their faults, hidden effects."""

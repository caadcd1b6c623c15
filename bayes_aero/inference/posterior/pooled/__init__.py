"""Manoeuvres pooled: parameters that scatter around the aircraft's, and the next flight."""

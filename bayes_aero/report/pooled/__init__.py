"""Manoeuvres beside each other and pooled: tables."""

"""Modes of motion: tables and sentences."""

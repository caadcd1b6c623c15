"""Readers whose libraries run in a process of their own."""

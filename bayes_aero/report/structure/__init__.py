"""Witnesses of a diagnosis as tables and sentences: sampled sets of terms."""

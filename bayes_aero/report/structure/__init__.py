"""Witnesses of a diagnosis as tables and sentences: weights of rivals, sampled sets of terms."""

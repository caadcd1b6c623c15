"""Estimates in the frequency domain: over a band at once, and while the record grows."""

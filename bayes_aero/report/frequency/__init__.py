"""Estimates in the frequency domain: page, tables and figures."""

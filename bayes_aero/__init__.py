"""Bayesian identification of non-linear aircraft aerodynamics from flight data."""

import jax

# The information matrix of a stall model spans ten decades; single precision loses its small eigenvalues.
jax.config.update("jax_enable_x64", True)

__version__ = "0.1.0"

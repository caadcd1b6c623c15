"""Posterior: samplers, diagnostics, dependence on priors."""

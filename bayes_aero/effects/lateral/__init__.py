"""Effects of lateral motion on the longitudinal coefficients."""

"""Structure that no effect of the catalogue explains, and parameters that change during the records."""

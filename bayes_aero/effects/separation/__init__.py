"""Flow separation and what depends on it."""

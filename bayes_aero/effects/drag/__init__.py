"""Effects on drag."""

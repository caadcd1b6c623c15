"""Effects on the rolling moment."""

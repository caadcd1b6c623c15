"""Effects on pitching moment."""

"""Effects on lift."""

"""Effects on the yawing moment."""

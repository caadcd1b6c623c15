"""Effects on the side force."""

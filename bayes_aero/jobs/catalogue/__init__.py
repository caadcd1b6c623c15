"""Effects that a user can name."""

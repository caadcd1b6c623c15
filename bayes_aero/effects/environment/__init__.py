"""Effects of the air."""

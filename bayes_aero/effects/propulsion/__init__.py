"""Effects of thrust."""

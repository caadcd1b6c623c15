"""Maximum likelihood: equation error and output error."""

"""Commands that hand a finished model over."""

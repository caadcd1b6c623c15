"""Commands that take up a finished result."""

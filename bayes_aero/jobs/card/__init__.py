"""A starter card from the columns of a file."""

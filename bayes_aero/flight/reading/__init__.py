"""From a file to a record."""

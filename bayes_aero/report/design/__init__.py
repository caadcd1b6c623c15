"""Test points that a diagnosis proposes, as a table and in sentences."""

"""The card: an aircraft, its channels, its model."""

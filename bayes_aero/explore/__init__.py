"""A finished result to look at: the model is flown again while its values change."""

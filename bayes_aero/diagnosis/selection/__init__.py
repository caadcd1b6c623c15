"""Forward selection, backward elimination, cross-validation."""

"""Results on disk: JSON, time histories, folders that appear whole."""

"""Parts of diagnosis.json."""

"""What a model gets wrong, which effect explains it, and what adding that effect gains."""

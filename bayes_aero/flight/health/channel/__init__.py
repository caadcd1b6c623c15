"""What is wrong with one channel by itself."""

"""What channels say of each other."""

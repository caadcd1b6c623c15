"""What residuals that are not white do to standard errors."""

"""What the acceptance tables share."""

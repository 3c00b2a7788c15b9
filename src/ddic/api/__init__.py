"""What ``import ddic`` offers."""

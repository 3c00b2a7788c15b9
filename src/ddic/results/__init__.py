"""What a measurement is and how it publishes itself."""

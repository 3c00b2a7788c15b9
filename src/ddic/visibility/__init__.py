"""What a frame shows of the specimen: brightness, sharpness, what is excluded, how far cells are believed."""

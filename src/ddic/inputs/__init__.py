"""What a case names, opened: images, cameras, mesh, start."""

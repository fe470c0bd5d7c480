"""Read and write captures: frames, what is known about them, and whether their order is right."""

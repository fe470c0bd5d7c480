"""Read and write captures: frames and metadata; check the order of the frames."""

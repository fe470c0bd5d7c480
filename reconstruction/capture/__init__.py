"""Read and write captures, which are frames with metadata, and check the order of the frames."""

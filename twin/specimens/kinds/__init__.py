"""Built-in kinds of specimens, one file each: configuration, shape and nominal features."""

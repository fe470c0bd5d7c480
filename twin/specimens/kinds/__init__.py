"""The built-in kinds of specimens, one file each: data model, shape and nominal features."""

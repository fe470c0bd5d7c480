"""The kinds of materials that a specimen is made of, one per file."""

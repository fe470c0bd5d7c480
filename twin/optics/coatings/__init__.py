"""The kinds of coatings, one per file."""

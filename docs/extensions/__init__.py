"""What the documentation adds to Sphinx: equations without scripts, tables and pictures of data."""

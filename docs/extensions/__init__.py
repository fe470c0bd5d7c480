"""What the documentation adds to Sphinx: equations, tables and pictures of data, names."""

"""Solid elements, the reference for the spectral press: large strain, and pads of any shape."""

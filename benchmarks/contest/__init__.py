"""Comparison of the same work by this project and by other programs (`benchmarks/peers.py`)."""

"""Decode, triangulate and evaluate fringe captures, real or rendered."""

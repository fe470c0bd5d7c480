"""Generators of files and folders as other programs write them."""

"""Finite-element models of the press: for large strain and for pads of any shape.

They are also the reference with which the spectral press is compared.
"""

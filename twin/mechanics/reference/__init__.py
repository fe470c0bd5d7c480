"""Independent references for the spectral press: semi-analytic, large strain, finite elements."""

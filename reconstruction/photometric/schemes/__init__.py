"""Built-in schemes that integrate slopes to heights, see `reconstruction.integration_schemes`."""

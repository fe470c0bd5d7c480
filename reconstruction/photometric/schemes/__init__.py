"""The built-in integration schemes, see `reconstruction.integration_schemes`."""

"""Identify what is not known of a sensor from what was measured with it."""

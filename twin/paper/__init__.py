"""Reproduce every table and figure of the paper from one parameter set, with spread over trials."""

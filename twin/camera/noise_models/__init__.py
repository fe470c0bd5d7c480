"""Kinds of camera noise, one file each; see `twin.config.noise_models`."""

"""Frozen, validated description of sensor, specimen, press and measurement."""

from twin.config.digest import digest, seed_sequence
from twin.config.errors import ConfigError
from twin.config.loading import decode_settings, load_experiment, validate_experiment, vary
from twin.config.models import Experiment
from twin.config.writing import to_toml

__all__ = [
    "ConfigError",
    "Experiment",
    "decode_settings",
    "digest",
    "load_experiment",
    "seed_sequence",
    "to_toml",
    "validate_experiment",
    "vary",
]

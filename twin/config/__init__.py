"""Frozen, validated description of sensor, specimen, press and measurement."""

from twin.config.base import ConfigError
from twin.config.digest import digest, seed_sequence
from twin.config.loading import (
    decode_settings,
    load_experiment,
    require_experiment,
    to_toml,
    validate_experiment,
    vary,
)
from twin.config.models import Experiment

__all__ = [
    "ConfigError",
    "Experiment",
    "decode_settings",
    "digest",
    "load_experiment",
    "require_experiment",
    "seed_sequence",
    "to_toml",
    "validate_experiment",
    "vary",
]

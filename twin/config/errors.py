"""Errors of the configuration; all of them are bad input (exit code 2)."""

from reconstruction.errors import InputError


class ConfigError(InputError):
    """An experiment file that cannot be used; one line per problem."""


class AssetCycleError(ConfigError):
    """Data files that `use` each other in a circle."""

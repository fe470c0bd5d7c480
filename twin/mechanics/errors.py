"""Errors of the press; each message is one line with the remedy."""

from reconstruction.errors import InputError


class PressError(InputError):
    """A press that the slab, the specimen or the solver's grid does not allow."""


class SolverError(InputError):
    """A contact solution that did not converge."""

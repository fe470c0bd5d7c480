"""Errors of the press; each message is one line that states the remedy."""

from reconstruction.errors import InputError


class PressError(InputError):
    """Error for a press that the slab, the specimen or the solver's grid does not allow."""


class SolverError(InputError):
    """Error for a contact solution that did not converge."""

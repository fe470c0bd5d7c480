"""Errors that tell a user what to change: one line, with place, value found and values allowed."""


class InputError(ValueError):
    """Input that cannot be used as given; base of every such error of this package."""


class CaptureError(InputError):
    """A stored capture or calibration that is missing, damaged or inconsistent."""


class FitError(InputError):
    """Points that do not determine the shape asked for."""

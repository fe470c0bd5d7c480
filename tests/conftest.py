"""Fixtures for all tests."""

from typing import Any

import pytest

from twin.optics.backend import activate


@pytest.fixture(scope="session")
def mi() -> Any:
    """Mitsuba with the backend of this machine."""
    activate()
    import mitsuba

    return mitsuba

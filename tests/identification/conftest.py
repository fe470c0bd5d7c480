"""Chains that end as soon as they are long enough."""

import pytest

from twin.identification import posterior


@pytest.fixture(autouse=True, scope="package")
def chains_checked_often():
    """Check every 200 steps whether a chain is long enough; 1000 steps cost 2 s a posterior."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(posterior, "_STEPS", 200)
        yield

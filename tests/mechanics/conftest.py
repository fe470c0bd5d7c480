"""Builders of the configurations that the mechanics tests press."""

from collections.abc import Callable

import pytest

from twin.config.models import Elastomer, Press
from twin.mechanics import PressedElastomer, press
from twin.specimens.kinds.ball import Ball

SlabBuilder = Callable[..., Elastomer]


def build_slab(**changes: object) -> Elastomer:
    values: dict[str, object] = {
        "thickness_mm": 4.0,
        "length_x_mm": 20.0,
        "length_y_mm": 20.0,
        "shore_a": 10.0,
        "young_modulus_kpa": 1000.0,
        "poisson_ratio": 0.49,
    }
    return Elastomer.model_validate(values | changes)


@pytest.fixture
def slab() -> SlabBuilder:
    """Build a 20 x 20 x 4 mm slab of 1 MPa, with changes by keyword."""
    return build_slab


@pytest.fixture(scope="session")
def reference_press() -> PressedElastomer:
    """A 4 mm ball 1 mm deep in the 20 x 20 x 4 mm slab: a finite-element solution exists for it."""
    return press(Ball(), build_slab(), Press(control="depth", depth_mm=1.0))

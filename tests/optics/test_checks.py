"""Errors before the press and the trace."""

import pytest

from reconstruction.errors import InputError
from twin.config import load_experiment
from twin.optics.checks import check_stack_size
from twin.pipeline import measure

LARGE = {"camera.width_px": 16384, "camera.height_px": 16384}


def test_a_stack_beyond_memory_is_rejected_before_the_press() -> None:
    """16384 x 16384 pixels in 53 frames: 6 bytes x 14.2e9, for which the process was killed."""
    with pytest.raises(
        InputError, match=r"found 2\.68e\+08 pixels in 53 frames, 85\.4 GB, "
    ) as caught:
        measure(load_experiment("examples/slab_ball", LARGE))
    assert str(caught.value).startswith("camera.width_px, height_px, binning: ")
    assert "\n" not in str(caught.value)


def test_binning_makes_it_smaller() -> None:
    check_stack_size(load_experiment("examples/slab_ball", LARGE | {"camera.binning": 4}))

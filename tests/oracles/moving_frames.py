"""A frame of a moving scene from scenes at rest: the reference of the interpolated stack."""

import numpy as np

from reconstruction.arrays import FloatArray, FloatImage
from twin.config.instant import experiment_at
from twin.config.models import Experiment
from twin.optics.frame_times import frame_times_s
from twin.optics.stack import RadianceStack
from twin.pipeline import Memory, render_bare


def exposure_times_s(
    experiment: Experiment, frame: int, count: int
) -> tuple[FloatArray, FloatArray]:
    """Return Gauss nodes of the exposure of a frame in row 0, and their shares of the light."""
    times = frame_times_s(experiment)
    nodes, weights = np.polynomial.legendre.leggauss(count)
    at_s = times.start_s[frame] + times.duration_s[frame] * (nodes + 1.0) / 2.0
    return at_s, weights / 2.0


def at_rest(experiment: Experiment, time_s: float) -> RadianceStack:
    """Return the whole stack of the scene at rest, as it is at a time: its mesh is displaced."""
    return render_bare(experiment_at(experiment, time_s), memory=Memory())


def frame_of_instants(experiment: Experiment, frame: int, count: int) -> FloatImage:
    """Return one frame, the mean of the frames of `count` scenes at rest during its exposure."""
    times_s, shares = exposure_times_s(experiment, frame, count)
    images = [at_rest(experiment, time_s).frames[frame] for time_s in times_s]
    return np.tensordot(shares, np.array(images), axes=1)

"""A pressed face in motion: the face of another press at each time.

A press takes longer than a trace. Therefore a face is pressed only at the moments, and at the times
of one frame for the error.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from reconstruction.arrays import BoolImage
from twin.config.models import Experiment
from twin.optics.connection import Rig, axial_range_mm
from twin.optics.moving_rig import LanePaths, TimedRays
from twin.optics.one_trace import Patches, trace_patches
from twin.optics.scene import coated_rig, coating_in_layer, marched_scene

if TYPE_CHECKING:
    from twin.mechanics.relief import FaceGrid


@dataclass(frozen=True, eq=False)
class MovingFace:
    """Coated face of a press that changes during the sequence.

    Attributes
    ----------
    experiment : experiment of the sequence; its rig is at rest
    face_at : returns the pressed face at a time, s, after the middle of the sequence
    """

    experiment: Experiment
    face_at: "Callable[[float], FaceGrid]"
    any_time: ClassVar[bool] = False

    @property
    def vibrates(self) -> bool:
        """Whether the motion has a vibration."""
        return self.experiment.motion.vibration.amplitude_um > 0.0

    @cached_property
    def _loaded(self) -> dict[float, tuple[Any, Rig]]:
        return {}

    def at(self, time_s: float) -> tuple[Any, Rig]:
        """Return the scene of the face at a time, with its rig."""
        if time_s not in self._loaded:
            face = self.face_at(time_s)
            scene = marched_scene(self.experiment, face, {"type": "diffuse"})
            scene.set_coating(coating_in_layer(self.experiment))
            self._loaded[time_s] = scene, coated_rig(self.experiment, face)
        return self._loaded[time_s]

    def axial_mm(self, time_s: float) -> tuple[float, float]:
        """Return the smallest and largest distance of the face along the projector's axis."""
        return axial_range_mm(*self.at(time_s))

    def patches_at(self, time_s: float, samples: int | None = None) -> Patches:
        """Return the traced rays of all pixels at a time, all samples or a number of them."""
        return trace_patches(*self.at(time_s), samples or self.experiment.render.samples).evaluate()

    def trace(self, rays: TimedRays) -> LanePaths:
        """Return the paths of camera rays, traced at their times; few times are different."""
        samples, paths = self.experiment.render.samples, []
        rays = rays.of_used_times()
        masks: list[BoolImage] = [
            np.asarray(rays.time_of == number) for number in range(len(rays.times_s))
        ]
        for time_s, mask in zip(rays.times_s, masks, strict=True):
            paths.append(LanePaths.of(*self.at(float(time_s)), rays.of(mask), samples))
        return LanePaths.merged(paths, masks)

"""A bare specimen in motion with its stage, and the light between their surfaces.

The light between surfaces is traced at two times of the sequence, the nodes of Gauss's quadrature,
and is linear in time between and beyond them.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from reconstruction.arrays import FloatArray, FloatImage
from twin.config.motion import Motion
from twin.optics.bounces import Bounces, add_bounces
from twin.optics.connection import FrameLight, Rig, axial_range_mm
from twin.optics.devices import SubPixels
from twin.optics.exposures import ExposureSequence
from twin.optics.moving_rig import LanePaths, TimedRays, moving_rig
from twin.optics.one_trace import Patches, trace_patches

_GAUSS = 1.0 / np.sqrt(3.0)


@dataclass(frozen=True, eq=False)
class MovingSpecimen:
    """A bare specimen on its stage: the loaded scene is at rest, and the rig moves about it."""

    scene: Any
    rig: Rig
    motion: Motion
    samples: int
    any_time: ClassVar[bool] = True

    @property
    def vibrates(self) -> bool:
        """Whether the motion has a vibration."""
        return self.motion.vibration.amplitude_um > 0.0

    def rig_at(self, time_s: float) -> Rig:
        """Return the rig relative to the scene at a time."""
        return moving_rig(self.rig, self.motion.pose_at(time_s)[None], mi.UInt32(0))

    def axial_mm(self, time_s: float) -> tuple[float, float]:
        """Return the smallest and largest distance of the scene along the projector's axis."""
        rest_from_world = np.linalg.inv(self.motion.pose_at(time_s))
        projector = self.rig.projector
        pose = rest_from_world @ projector.T_world_from_device
        moved = replace(projector, T_world_from_device=pose)
        return axial_range_mm(self.scene, replace(self.rig, projector=moved))

    def patches_at(self, time_s: float, samples: int | None = None) -> Patches:
        """Return the traced rays of all pixels at a time, all samples or a number of them."""
        return trace_patches(self.scene, self.rig_at(time_s), samples or self.samples).evaluate()

    def trace(self, rays: TimedRays) -> LanePaths:
        """Return the paths of camera rays, each traced at its own time."""
        rays = rays.of_used_times()
        poses = np.array([self.motion.pose_at(time_s) for time_s in rays.times_s]).reshape(-1, 4, 4)
        rig = moving_rig(self.rig, poses, mi.UInt32(rays.time_of.astype(np.uint32)))
        return LanePaths.of(self.scene, rig, rays, self.samples)

    def between_surfaces(
        self, light: FrameLight, sequence: ExposureSequence, bounces: Bounces
    ) -> list[FloatImage]:
        """Return the light of every frame that is reflected at least twice, (row, col) each."""
        pinhole = self.rig.camera.pinhole
        width, height = pinhole.width_px, pinhole.height_px
        grid = SubPixels.of_image(width, height, self.samples)
        images = [np.zeros((height, width), np.float32) for _ in light.sequence]
        for place in (-_GAUSS, _GAUSS):
            rig = self.rig_at(sequence.time_s(place))
            dark = [dr.zeros(mi.Float, width * height) for _ in images]
            traced = add_bounces(self.scene, rig, light, grid, bounces=bounces, frames=dark)
            for frame, values in zip(light.sequence, traced, strict=True):
                share = (1.0 + _row_places(sequence, frame, height) / place) / 2.0
                images[frame] += np.asarray(values).reshape(height, width) * share[:, None]
        return images


def _row_places(sequence: ExposureSequence, frame: int, rows: int) -> FloatArray:
    """Return the relative time in the middle of the exposure of each row, (row,)."""
    (middle,) = sequence.nodes(frame, 1).places
    return np.asarray(middle + sequence.row_delay * np.arange(rows))

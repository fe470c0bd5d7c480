"""Render the sequence of a moving scene: direct light at its own time, and light between surfaces.

The light between surfaces is traced at two times of the sequence, the nodes of Gauss's quadrature,
and is linear in time between and beyond them. This module must be imported within a
`renderer_session`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from reconstruction.arrays import FloatArray, FloatImage
from twin.config.digest import seed_sequence
from twin.config.models import Experiment
from twin.config.motion import Motion
from twin.optics.bounces import Bounces, add_bounces
from twin.optics.connection import FrameLight, Rig, axial_range_mm
from twin.optics.devices import SubPixels
from twin.optics.exposures import ExposureSequence
from twin.optics.frame_times import frame_times_s, row_delay_s
from twin.optics.light import LightTable
from twin.optics.moving_rig import LanePaths, TimedRays, moving_rig
from twin.optics.moving_stack import MovingStack
from twin.optics.one_trace import Patches, trace_patches
from twin.optics.session import renderer_session
from twin.optics.stack import RadianceStack
from twin.pipeline import trace

Progress = Callable[[float], None]

_GAUSS = 1.0 / np.sqrt(3.0)


@dataclass(frozen=True, eq=False)
class MovingSpecimen:
    """A bare specimen on its stage: the loaded scene is at rest, and the rig moves about it."""

    scene: Any
    rig: Rig
    motion: Motion
    samples: int

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

    def patches_at(self, time_s: float) -> Patches:
        """Return the traced rays of all pixels at a time."""
        return trace_patches(self.scene, self.rig_at(time_s), self.samples).evaluate()

    def trace(self, rays: TimedRays) -> LanePaths:
        """Return the paths of camera rays, each traced at its own time."""
        times_s, pose_of_lane = np.unique(rays.time_s, return_inverse=True)
        poses = np.array([self.motion.pose_at(time_s) for time_s in times_s]).reshape(-1, 4, 4)
        rig = moving_rig(self.rig, poses, mi.UInt32(pose_of_lane.astype(np.uint32)))
        return LanePaths.of(self.scene, rig, rays, self.samples)


def exposures_of(experiment: Experiment) -> ExposureSequence:
    """Return the relative times of all frames of an experiment.

    Raises
    ------
    InputError : the exposure is automatic, or does not fit in the period of its frame
    """
    return ExposureSequence.of(frame_times_s(experiment), row_delay_s(experiment))


@renderer_session()
def moving_view(experiment: Experiment, geometry: trace.Geometry, view: trace.View) -> trace.View:
    """Return a view with the axial distances of the scene over its whole sequence.

    Parameters
    ----------
    view : the view in the middle of the sequence, of which the truth is kept
    """
    scene, half_s = moving_scene(experiment, geometry, view), exposures_of(experiment).half_s
    ranges_mm = [scene.axial_mm(at * half_s) for at in np.linspace(-1.0, 1.0, 9)]
    nearest_mm, farthest_mm = np.transpose(ranges_mm)
    return replace(view, axial_mm=(float(nearest_mm.min()), float(farthest_mm.max())))


def moving_scene(
    experiment: Experiment, geometry: trace.Geometry, view: trace.View
) -> MovingSpecimen:
    """Return scene and rig of an experiment as functions of time."""
    motion = Motion(**experiment.motion.model_dump())
    return MovingSpecimen(geometry.scene, view.rig, motion, experiment.render.samples)


@renderer_session()
def light_moving(
    experiment: Experiment,
    geometry: trace.Geometry,
    view: trace.View,
    tables: dict[str, LightTable],
    progress: Progress,
) -> RadianceStack:
    """Return the radiance of all frames of a moving scene; the truth is that of the middle.

    Parameters
    ----------
    progress : function that is called with the finished fraction, 0 to 1
    """
    pinhole, sequence = view.rig.camera.pinhole, exposures_of(experiment)
    light, scene = FrameLight(tables), moving_scene(experiment, geometry, view)
    size_px = pinhole.width_px, pinhole.height_px
    stack = MovingStack(scene, sequence, light, size_px, experiment.render.samples)
    rng = np.random.default_rng(seed_sequence(experiment, "motion"))
    frames, accuracy = stack.frames(rng, progress)
    bounces = trace.bounces_of(experiment, geometry, None, tables)
    if bounces is not None and bounces.most:
        for index, image in enumerate(_between_surfaces(stack, scene, bounces)):
            frames[index][...] += image
    return RadianceStack(frames, view.truth, accuracy)


def _between_surfaces(
    stack: MovingStack, scene: MovingSpecimen, bounces: Bounces
) -> list[FloatImage]:
    """Return the light of every frame that is reflected at least twice, (row, col) each."""
    width, height = stack.size_px
    grid = SubPixels.of_image(width, height, stack.samples)
    images = [np.zeros((height, width), np.float32) for _ in stack.light.sequence]
    for place in (-_GAUSS, _GAUSS):
        rig = scene.rig_at(place * stack.sequence.half_s)
        dark = [dr.zeros(mi.Float, width * height) for _ in images]
        traced = add_bounces(scene.scene, rig, stack.light, grid, bounces=bounces, frames=dark)
        for frame, values in zip(stack.light.sequence, traced, strict=True):
            share = (1.0 + _row_places(stack, frame) / place) / 2.0
            images[frame] += np.asarray(values).reshape(height, width) * share[:, None]
    return images


def _row_places(stack: MovingStack, frame: int) -> FloatArray:
    """Return the relative time in the middle of the exposure of each row, (row,)."""
    sequence = stack.sequence
    (middle,) = sequence.nodes(frame, 1).places
    return np.asarray(middle + sequence.row_delay * np.arange(stack.size_px[1]))
